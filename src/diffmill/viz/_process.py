"""What the figures need of the cutting process: fine forces and one tooth's chip."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._types import FloatRows3, FloatSteps
from ..cutter import AbstractCutter
from ..sim import Plain, ProcessPlan
from ..sim._history import ProcessState, end_period, initial_state
from ..sim._period import (
    Engagement,
    begin_period,
    element_heights,
    substep_chip,
)
from ..sim._process_alone import middles_of
from ..workpiece import Pose, Stock
from ._chip import ChipChart
from ._forces import ForceRecord


def force_record(
    time: FloatSteps,
    samples: Float[Array, "step sample 3"] | Float[np.ndarray, "step sample 3"],
) -> ForceRecord:
    """Return forces within the tooth periods as one record over time.

    Args:
        time: Tooth instants t_k [s], shape (step,).
        samples: Forces in the middles of equal parts of the period that ends at t_k
            [N], shape (step, sample, 3); row 0 belongs to no period and is left out.

    Returns:
        The record.
    """
    at = np.asarray(time, dtype=np.float64)
    force = np.asarray(samples, dtype=np.float64)[1:]
    period = float((at[-1] - at[0]) / (at.shape[0] - 1))
    part = (np.arange(force.shape[1]) + 0.5) / force.shape[1]
    fine = at[:-1, None] + part * period
    return ForceRecord(fine.reshape(-1), force.reshape(-1, 3), period)


def chip_chart(
    positions: FloatRows3,
    stock: Stock,
    cutter: AbstractCutter,
    plan: ProcessPlan,
    *,
    step: int,
) -> ChipChart:
    """Return the chip that the teeth meet in the tooth period before `step`.

    The process runs along the path up to that period, without forces.

    Args:
        positions: Tool tip in `work` at the tooth instants [m], shape (step, 3).
        stock: The raw workpiece.
        cutter: The cutter.
        plan: Sizes of the process.
        step: Row of the path at which the period ends, from 1.

    Returns:
        The chip in the feed frame: angle 0 is on the left of the feed, the angle
        grows clockwise. Angles of a helical cutter are true to half a sample.
    """
    if not 1 <= step < positions.shape[0]:
        raise ValueError(
            f"Argument `step` must lie between 1 and {positions.shape[0] - 1}, but is "
            f"{step}."
        )
    rows = jnp.asarray(positions[: step + 1], stock.origin.dtype)
    angle, chip, weight = jax.tree.map(
        np.asarray, _period_chip(rows, stock, cutter, plan)
    )
    feed = np.asarray(rows[-1] - rows[-2], dtype=np.float64)
    heading = math.atan2(feed[0], feed[1]) - math.pi / 2
    height = np.asarray(element_heights(plan, cutter, rows.dtype))
    return _chart(angle, chip, weight, heading, plan, height)


def _period_chip(
    rows: Float[Array, "step 3"],
    stock: Stock,
    cutter: AbstractCutter,
    plan: ProcessPlan,
) -> tuple[
    Float[Array, "substep angle tooth disc"],
    Float[Array, "substep angle tooth element"],
    Float[Array, "substep angle tooth element"],
]:
    """Return angles, chip and occupancy of the last period of `rows`."""
    adjoint = Plain()
    count = rows.shape[0]
    path = Pose(rows)
    state, _ = initial_state(plan, stock, cutter, path[0], count, adjoint)

    def look(
        state: ProcessState, x: tuple[Array, Pose, Pose]
    ) -> tuple[ProcessState, Engagement, Pose]:
        index, start, poses = x
        state, cut, _ = begin_period(plan, cutter, state, index, start, poses, adjoint)
        return state, cut, poses

    def advance(
        state: ProcessState, x: tuple[Array, Pose, Pose]
    ) -> tuple[ProcessState, None]:
        state, _, poses = look(state, x)
        return end_period(state, poses), None

    index = jnp.arange(1, count, dtype=jnp.int32)
    xs = (index, path[:-1], middles_of(plan, path))

    @jax.jit
    def run(
        state: ProcessState,
    ) -> tuple[Array, Array, Array]:
        state, _ = jax.lax.scan(advance, state, jax.tree.map(lambda v: v[:-1], xs))
        state, cut, poses = look(state, jax.tree.map(lambda v: v[-1], xs))
        chip = jax.vmap(
            lambda pose, earlier, phi, tooth: substep_chip(
                plan, cutter, pose, earlier, cut.thinned, phi, tooth
            ),
            in_axes=(0, 1, 0, 0),
        )(poses, state.recent, cut.angle, cut.tooth)
        return cut.angle, jnp.clip(chip, 0, cutter.diameter / 2), cut.occupancy

    return run(state)


def _chart(
    angle: Float[np.ndarray, "substep angle tooth disc"],
    chip: Float[np.ndarray, "substep angle tooth some"],
    weight: Float[np.ndarray, "substep angle tooth element"],
    heading: float,
    plan: ProcessPlan,
    height: Float[np.ndarray, " element"],
) -> ChipChart:
    """Sort the samples of all teeth of a period into one turn of one tooth."""
    shape, elements = weight.shape, height.size
    columns = plan.angles
    slot = np.round(np.broadcast_to(angle, shape) / (2 * np.pi) * columns - 0.5)
    slot = slot.astype(np.int64).reshape(-1, elements) % columns
    element = np.broadcast_to(np.arange(elements), slot.shape)
    chart, share = np.zeros((2, elements, columns))
    chart[element, slot] = np.broadcast_to(chip, shape).reshape(-1, elements)
    share[element, slot] = weight.reshape(-1, elements)
    turn = 2 * np.pi * (np.arange(columns) + 0.5) / columns - heading
    turn = (turn + np.pi / 2) % (2 * np.pi) - np.pi / 2
    order = np.argsort(turn)
    return ChipChart(turn[order], height, chart[:, order], share[:, order])
