"""The process of a solution once more, for whoever looks at it closer.

Where the tool was and how it leaned, how finely the process is computed and the laws of
both edges are those of the run. Only the robot is left out: between the tooth instants
the tool goes along a smooth curve through them.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..._job import Job
from ...cutter import AbstractCutter
from ...process import (
    Engagement,
    ProcessPlan,
    ProcessSolution,
    ProcessState,
    ThroughRays,
    advance_process,
    element_heights,
    end_period,
    ends_of,
    initial_state,
    middles_of,
    path_poses,
    simulate_process,
    substep_chip,
    tool_frame,
)
from ...workpiece import Pose, Stock
from .._analysis.stability import joint_poses
from .._machine.commands import path_axes
from .simulate import Solution, job_plan, with_precision


def actual_poses(job: Job, solution: Solution) -> Pose:
    """Return the poses of the tool in `work` at the tooth instants, shape (step, 3).

    Args:
        job: The job.
        solution: Its solution.

    Returns:
        The poses; without an axis where the tool stands along +z all the time.
    """
    tips = jnp.asarray(solution.actual)
    if job.robot is None or solution.joint_positions is None:
        return path_poses(tips, path_axes(job))
    if not job.simulation.axes:
        return Pose(tips)
    frame = jnp.asarray(job.T_base_work, tips.dtype)
    joints = jnp.asarray(solution.joint_positions)
    return Pose(tips, joint_poses(job.robot, frame, joints, False).axis)


def replay_process(job: Job, solution: Solution) -> ProcessSolution:
    """Return the process of a solution with the force at every angle sample.

    Args:
        job: The job.
        solution: Its solution.

    Returns:
        The process along the actual poses. Check `.result`.
    """
    job = with_precision(job)
    return _replay(job, actual_poses(job, solution))


@eqx.filter_jit
def _replay(job: Job, poses: Pose) -> ProcessSolution:
    return simulate_process(
        poses.tip,
        job.stock,
        job.cutter,
        job.law,
        job.spindle_speed,
        poses.axis,
        plan=job_plan(job),
        bottom_law=job.bottom_law,
        keeps_instantaneous=True,
    )


class ToothChip(eqx.Module):
    """The chip that one tooth meets in a revolution, on the host.

    Attributes:
        angle: Immersion angle of the samples [rad], shape (sample, element).
        chip_thickness: Chip thickness h in the stock [m], same shape.
        weight: Fraction of the sample that is in stock, from 0 to 1, same shape.
        is_of_tooth: Which samples are the tooth's, same shape.
        height: Height of each edge element above the tip [m], shape (element,).
        feed_angle: Direction of the feed, from tool y clockwise [rad].
    """

    angle: Float[np.ndarray, "sample element"]
    chip_thickness: Float[np.ndarray, "sample element"]
    weight: Float[np.ndarray, "sample element"]
    is_of_tooth: Bool[np.ndarray, "sample element"]
    height: Float[np.ndarray, " element"]
    feed_angle: float


def tooth_chip(
    path: Pose, stock: Stock, cutter: AbstractCutter, plan: ProcessPlan, *, step: int
) -> ToothChip:
    """Return the chip that tooth 0 meets in the revolution that ends at a step.

    The process runs along the path up to there, without forces.

    Args:
        path: Poses at the tooth instants in `work`, shape (step, 3).
        stock: The raw workpiece.
        cutter: The cutter.
        plan: Sizes of the process.
        step: Row of the path at which the revolution ends, from 1; near the start of
            the path the revolution is not whole.

    Returns:
        The chip on the edge, without the flat end of the tool.

    Raises:
        ValueError: If there is no such step.
    """
    rows = path.tip.shape[0]
    if not 1 <= step < rows:
        raise ValueError(
            f"Argument `step` must lie between 1 and {rows - 1}, but is {step}."
        )
    part = path[: step + 1]
    count = min(cutter.flute_count, step)
    found = _last_periods(part, stock, cutter, plan, count)
    angle, tooth, chip, weight = (np.asarray(x, np.float64) for x in found)
    shape = weight.shape
    first = 0 if plan.profile is None else plan.profile.bottom
    flat = lambda x: np.broadcast_to(x, shape).reshape(-1, shape[-1])[:, first:]
    height = np.asarray(element_heights(plan, cutter, part.tip.dtype), np.float64)
    frame = np.asarray(tool_frame(part[-1].direction()), np.float64)
    feed = (np.asarray(part.tip[-1] - part.tip[-2], np.float64)) @ frame
    return ToothChip(
        angle=flat(angle),
        chip_thickness=flat(chip),
        weight=flat(weight),
        is_of_tooth=flat(tooth) == 0,
        height=height[first:],
        feed_angle=float(np.arctan2(feed[0], feed[1])),
    )


@eqx.filter_jit
def _last_periods(
    path: Pose, stock: Stock, cutter: AbstractCutter, plan: ProcessPlan, count: int
) -> tuple[
    Float[Array, "period substep angle kept disc"],
    Int[Array, "period substep angle kept disc"],
    Float[Array, "period substep angle kept element"],
    Float[Array, "period substep angle kept element"],
]:
    """Return angle, tooth, chip in the stock and occupancy in the last periods."""
    adjoint, rows = ThroughRays(), path.tip.shape[0]
    state, _ = initial_state(plan, stock, cutter, path[0], rows, adjoint)

    def period(
        state: ProcessState, x: tuple[Array, Pose, Pose, Pose]
    ) -> tuple[ProcessState, tuple[Engagement, Array]]:
        index, start, poses, ends = x
        state, cut, _ = advance_process(
            plan, cutter, state, index, start, poses, adjoint
        )
        chip = jax.vmap(
            lambda pose, earlier, samples: substep_chip(
                plan, cutter, pose, earlier, cut.thinned, samples
            ),
            in_axes=(0, 1, 0),
        )(poses, state.recent, cut.samples)
        chip = jnp.clip(chip, 0, cutter.diameter / 2) * cut.samples.chip_share
        return end_period(state, poses, ends), (cut, chip)

    index = jnp.arange(1, rows, dtype=jnp.int32)
    xs = (index, path[:-1], middles_of(plan, path), ends_of(plan, path))
    before = jax.tree.map(lambda x: x[:-count], xs)
    last = jax.tree.map(lambda x: x[-count:], xs)
    state, _ = jax.lax.scan(lambda s, x: (period(s, x)[0], None), state, before)
    _, (cut, chip) = jax.lax.scan(period, state, last)
    samples = cut.samples
    return samples.angle, samples.tooth, chip, samples.occupancy
