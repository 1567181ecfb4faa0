"""The cutting process along a given path, without a robot."""

import math

import equinox as eqx
import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._result import RESULTS
from .._types import FloatRows3, IntScalar, RealScalarLike
from ..cutter import AbstractCutter
from ..cutting import AbstractForceLaw
from ..workpiece import Pose, Stock
from ._discretisation import ChipModel, ProcessPlan, is_plunging, process_plan
from ._live_rows import last_row, live_rows, when_live
from ._removal_history import (
    ProcessState,
    Removed,
    end_period,
    initial_state,
    remove_all,
)
from ._stock_derivatives import AbstractAdjoint, ThroughRays
from ._tooth_period import (
    Engagement,
    advance_process,
    substep_ends,
    substep_middles,
    substep_wrench,
)


class ProcessSolution(eqx.Module):
    """Solution of a process without a machine.

    Attributes:
        time: Tooth instants [s], shape (step,).
        force: Mean force on the tool over the tooth period before each instant, in
            `work` [N], shape (step, 3); zero in row 0.
        removed_volume: Volume that each pose removes [m^3], shape (step,).
        shank_volume: What of it the shank above the flutes takes [m^3], which no tool
            can: shape (step,).
        initial_overlap_volume: Stock inside the tool at the first pose [m^3].
        stock: The stock after the last pose.
        has_failed: Whether a flag was up after each step, shape (step,).
        result: Outcome of the run.
        instantaneous_force: Force at every angle sample of every period [N], shape
            (step, sample, 3), if it was asked for.
    """

    time: Float[Array, " step"]
    force: Float[Array, "step 3"]
    removed_volume: Float[Array, " step"]
    shank_volume: Float[Array, " step"]
    initial_overlap_volume: Float[Array, ""]
    stock: Stock
    has_failed: Bool[Array, " step"]
    result: RESULTS
    instantaneous_force: Float[Array, "step sample 3"] | None


def simulate_process(
    positions: FloatRows3,
    stock: Stock,
    cutter: AbstractCutter,
    law: AbstractForceLaw,
    spindle_speed: RealScalarLike,
    axes: FloatRows3 | None = None,
    *,
    plan: ProcessPlan | None = None,
    angles: int | None = None,
    axial_depth: float | None = None,
    adjoint: AbstractAdjoint | None = None,
    bottom_law: AbstractForceLaw | None = None,
    keeps_instantaneous: bool = False,
    chip: ChipModel = "near_far",
    row_count: IntScalar | None = None,
) -> ProcessSolution:
    """Cut along a path, one row per tooth period.

    Args:
        positions: Tool tip in `work` at the tooth instants [m], shape (step, 3).
        stock: The raw workpiece.
        cutter: The cutter.
        law: The force law.
        spindle_speed: [rad/s], shape ().
        axes: Tool axis from tip to shank, unit vectors, shape (step, 3); +z if not
            given.
        plan: Sizes of the process; chosen from `angles`, `axial_depth` and `chip` if
            not given.
        angles: Samples of the immersion angle per revolution.
        axial_depth: Deepest immersion of the tip below the top of the stock [m].
            Taken from the path if that is not traced, else the height of the stock
            or the flutes, whichever is less.
        adjoint: How to differentiate; `ThroughRays()` if not given.
        bottom_law: The law of the bottom edge; derived from `law` if not given.
        keeps_instantaneous: Whether to return the force at every angle sample.
        chip: The chip model: "near_far" is smooth and accurate; "point_cloud" is the
            paper's, hard, only for flat cutters that stand upright.
        row_count: How many rows count, those behind leave everything as it is; shape
            (). All rows if not given.

    Returns:
        The forces, volumes and the final stock. Check `.result` for an overflow.

    Raises:
        ValueError: An argument has a wrong shape, an axis is not a unit vector, or a
            point cloud is asked for where there is none.

    Differentiability: in positions, coefficients and diameter, in forward and reverse
    mode, except at the kinks of chips and rays. Under `ThroughPoses` the volumes and
    the stock are constants. With "point_cloud" derivatives exist but are hard: they
    follow the rays that hold the extreme points between the jumps from ray to ray, and
    under `ThroughPoses` ends that earlier poses cut are constants.
    """
    dtype = stock.origin.dtype
    positions = _rows(positions, "positions", dtype)
    axes = _directions(axes, positions.shape[0], dtype)
    if plan is None:
        plan = _plan_of_path(
            positions, axes, stock, cutter, (angles, axial_depth), chip
        )
    adjoint = ThroughRays() if adjoint is None else adjoint
    step_count = positions.shape[0]
    path = path_poses(positions, axes)
    state, overlap = initial_state(plan, stock, cutter, path[0], step_count, adjoint)

    def step(
        state: ProcessState, x: tuple[Array, Pose, Pose, Pose, Array | None]
    ) -> tuple[ProcessState, tuple[Array, Array | None, Removed, Array]]:
        index, start, poses, ends, is_live = x
        state, cut, removed = advance_process(
            plan, cutter, state, index, start, poses, adjoint, is_live
        )
        laws = (law, bottom_law)
        samples = when_live(
            is_live,
            lambda: _period_force(plan, cutter, laws, poses, state.recent, cut),
        )
        state = end_period(state, poses, ends)
        kept = samples if keeps_instantaneous else None
        failed = state.has_overflow | state.is_beyond
        return state, (jnp.mean(samples, axis=0), kept, removed, failed)

    index = jnp.arange(1, step_count, dtype=jnp.int32)
    middles = middles_of(plan, path, row_count)
    ends = ends_of(plan, path, row_count)
    xs = (index, path[:-1], middles, ends, live_rows(index, row_count))
    state, (force, samples, removed, failed) = jax.lax.scan(step, state, xs)
    last = last_row(step_count, row_count)
    state, rest = remove_all(plan, cutter, state, last, path[last], step_count, adjoint)
    period = 2 * math.pi / (jnp.asarray(spindle_speed, dtype) * cutter.flute_count)
    volume, by_shank = volumes_by_pose(step_count, removed, rest)
    return ProcessSolution(
        time=period * jnp.arange(step_count, dtype=dtype),
        force=jnp.concatenate([jnp.zeros((1, 3), dtype), force]),
        removed_volume=volume,
        shank_volume=by_shank,
        initial_overlap_volume=overlap,
        stock=state.stock,
        has_failed=failed_rows(failed, state, last),
        result=outcome(state, jnp.all(jnp.isfinite(force))),
        instantaneous_force=None
        if samples is None
        else jnp.concatenate([jnp.zeros_like(samples[:1]), samples]),
    )


def _period_force(
    plan: ProcessPlan,
    cutter: AbstractCutter,
    laws: tuple[AbstractForceLaw, AbstractForceLaw | None],
    poses: Pose,
    recent: Pose,
    cut: Engagement,
) -> Float[Array, "angle 3"]:
    """Return the force at all angles of a period, sub-step by sub-step."""
    wrench = jax.vmap(
        lambda pose, earlier, samples, bottom: substep_wrench(
            plan, cutter, *laws, pose, earlier, cut.thinned, samples, bottom
        ),
        in_axes=(0, 1, 0, 0),
    )
    found = wrench(poses, recent, cut.samples, cut.bottom)
    return found[..., :3].reshape(-1, 3)


def _plan_of_path(
    positions: FloatRows3,
    axes: Float[Array, "step 3"] | Float[np.ndarray, "step 3"] | None,
    stock: Stock,
    cutter: AbstractCutter,
    sizes: tuple[int | None, float | None],
    chip: ChipModel,
) -> ProcessPlan:
    """Choose the sizes for a path; what a traced path hides is taken at its widest."""
    angles, axial_depth = sizes
    if axial_depth is None:
        axial_depth = path_depth(positions, stock, cutter)
    is_traced = isinstance(positions, jax.core.Tracer)
    return process_plan(
        stock,
        cutter,
        axial_depth=axial_depth,
        angles=angles,
        axes=axes if isinstance(axes, np.ndarray) else None,
        is_upright=axes is None,
        plunges=is_traced or is_plunging(positions, stock.top),
        chip=chip,
    )


def within_periods(
    positions: Float[Array, "step 3"], shares: Float[Array, " substep"]
) -> Float[Array, "period substep 3"]:
    """Return where the tip is within the periods between given instants.

    Cubic through the two instants, with the slopes of their neighbours (Catmull-Rom):
    a chip is the difference of two such positions, and with straight lines between
    the instants a shaking tool would cut a different chip.

    Args:
        positions: Tip at the tooth instants [m], shape (step, 3).
        shares: Share of the period at which to look, shape (substep,).

    Returns:
        Tips [m], shape (step - 1, substep, 3).

    Differentiability: linear.
    """
    first = 2 * positions[:1] - positions[1:2]
    last = 2 * positions[-1:] - positions[-2:-1]
    padded = jnp.concatenate([first, positions, last])
    p0, p1, p2, p3 = (padded[i : i + positions.shape[0] - 1, None] for i in range(4))
    t = shares[None, :, None]
    # From differences only, so that a tool that stands still stands exactly still.
    rise, start, stop = p2 - p1, 0.5 * (p2 - p0), 0.5 * (p3 - p1)
    bend = 3 * rise - 2 * start - stop + t * (start + stop - 2 * rise)
    return p1 + t * (start + t * bend)


def volumes_by_pose(
    step_count: int, removed: Removed, rest: Removed
) -> tuple[Float[Array, " step"], Float[Array, " step"]]:
    """Return what each pose took, and its shank, from steps that removed others."""
    both = []
    for taken, last in (
        (removed.volume, rest.volume),
        (removed.by_shank, rest.by_shank),
    ):
        volume = jnp.zeros(step_count, taken.dtype)
        volume = volume.at[removed.pose.reshape(-1)].add(taken.reshape(-1))
        both.append(volume.at[rest.pose].add(last))
    return both[0], both[1]


def failed_rows(
    failed: Bool[Array, " period"], end: ProcessState, last: Int[Array, ""]
) -> Bool[Array, " step"]:
    """Return whether a flag was up after each step.

    Args:
        failed: Whether one was up after each period, shape (period,).
        end: The state after the last removal.
        last: The last step, to which that belongs.
    """
    rows = jnp.concatenate([jnp.zeros(1, bool), failed])
    return rows.at[last].set(rows[last] | end.has_overflow | end.is_beyond)


def outcome(state: ProcessState, is_finite: Bool[Array, ""]) -> RESULTS:
    """Return the outcome of a run from the flags in its last state."""
    result = RESULTS.where(state.is_beyond, RESULTS.window_overflow, RESULTS.successful)
    result = RESULTS.where(state.has_overflow, RESULTS.interval_overflow, result)
    return RESULTS.where(is_finite, result, RESULTS.non_finite)


def path_depth(positions: FloatRows3, stock: Stock, cutter: AbstractCutter) -> float:
    """Return how deep a path goes below the top of the stock [m].

    Args:
        positions: Tool tip in `work` [m], shape (step, 3); may be traced.
        stock: The raw workpiece.
        cutter: The cutter.

    Returns:
        The deepest immersion of a path known on the host; for a traced path the
        height of the stock or of the flutes, whichever is less.
    """
    counts = stock.families[0].ends.shape[1]
    height = counts * stock.spacing
    if isinstance(positions, jax.core.Tracer):
        return min(cutter.flute_length, height)
    deepest = stock.top - float(np.min(np.asarray(positions)[:, 2]))
    return min(max(deepest, 0.0) + stock.spacing, height)


def _rows(values: FloatRows3, name: str, dtype: jnp.dtype) -> Float[Array, "step 3"]:
    rows = jnp.asarray(values, dtype)
    if rows.ndim != 2 or rows.shape[1] != 3 or rows.shape[0] < 2:
        raise ValueError(
            f"Argument `{name}` must have shape (step, 3) with at least 2 steps, but "
            f"has shape {rows.shape}."
        )
    return rows


def _directions(
    axes: FloatRows3 | None, step_count: int, dtype: jnp.dtype
) -> Float[Array, "step 3"] | Float[np.ndarray, "step 3"] | None:
    """Return the axes, or None if the tool is known to stand along +z."""
    if axes is None:
        return None
    if isinstance(axes, jax.core.Tracer):
        return jnp.asarray(axes, dtype)
    rows = np.asarray(axes, np.dtype(dtype))
    if rows.shape != (step_count, 3):
        raise ValueError(
            f"Argument `axes` must have shape ({step_count}, 3), as `positions`, but "
            f"has shape {rows.shape}."
        )
    off = np.abs(np.linalg.norm(rows, axis=1) - 1)
    if not np.all(off < 1e-4):
        raise ValueError(
            f"Argument `axes` must have unit vectors, but row {int(np.argmax(off))} "
            f"has length {np.linalg.norm(rows[np.argmax(off)]):g}."
        )
    return None if np.allclose(rows, [0.0, 0.0, 1.0], atol=1e-9) else rows


def path_poses(
    positions: Float[Array, "step 3"],
    axes: Float[Array, "step 3"] | Float[np.ndarray, "step 3"] | None,
) -> Pose:
    """Return the poses of a path."""
    if axes is None:
        return Pose(positions)
    return Pose(positions, jnp.asarray(axes, positions.dtype))


def middles_of(
    plan: ProcessPlan, path: Pose, row_count: IntScalar | None = None
) -> Pose:
    """Return the poses in the middle of the sub-steps, shape (period, substep, 3).

    Args:
        plan: Sizes of the process.
        path: Poses at the tooth instants, shape (step, 3).
        row_count: How many of them count; all if None.
    """
    return _between(path, substep_middles(plan, path.tip.dtype), row_count)


def ends_of(plan: ProcessPlan, path: Pose, row_count: IntScalar | None = None) -> Pose:
    """Return the poses at the ends of the sub-steps; see `middles_of`.

    Behind the last row that counts the tool is at rest.
    """
    ends = _between(path, substep_ends(plan, path.tip.dtype), row_count)
    if row_count is None:
        return ends
    count = path.tip.shape[0]
    is_live = jnp.arange(1, count, dtype=jnp.int32) < row_count
    rest = path[last_row(count, row_count)]
    return jax.tree.map(
        lambda x, end: jnp.where(is_live[:, None, None], x, end), ends, rest
    )


def _between(
    path: Pose, shares: Float[Array, " substep"], row_count: IntScalar | None
) -> Pose:
    if row_count is not None:
        # The curve through the last rows goes on behind them as at the path's end.
        end = last_row(path.tip.shape[0], row_count)
        ahead = lambda rows: rows.at[row_count].set(
            2 * rows[end] - rows[end - 1], mode="drop"
        )
        path = jax.tree.map(ahead, path)
    tip = within_periods(path.tip, shares)
    if path.axis is None:
        return Pose(tip)
    axis = within_periods(path.axis, shares)
    return Pose(tip, axis / jnp.linalg.norm(axis, axis=-1, keepdims=True))
