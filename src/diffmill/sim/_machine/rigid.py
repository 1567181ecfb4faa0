"""A machine that goes where it is told: the process alone, along a given path."""

import equinox as eqx
import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..._padding import if_valid
from ..._types import FloatRows3, IntScalar, RealScalarLike
from ...cutter import AbstractCutter
from ...cutting import AbstractForceLaw
from ...process import (
    AbstractAdjoint,
    AbstractEngagement,
    Engagement,
    Immersion,
    Process,
    choose_engagement,
)
from ...workpiece import Pose, Stock
from .machine import (
    AbstractMachine,
    Period,
    PeriodRow,
    Run,
    RunState,
    StockAccess,
    TurnChips,
)


class PathPiece(eqx.Module):
    """Some rows of a path, with the row before them and the row behind them.

    The curve between two instants follows from their neighbours. Before the first row
    of a path it goes straight on.

    Attributes:
        poses: Poses at all of these rows, shape (step + 2, 3).
        row_count: How many of them are of the path, the first ones, shape (); the curve
            goes straight on behind the last.
        first: Row of the path at which the piece begins, shape ().
    """

    poses: Pose
    row_count: Int[Array, ""]
    first: Int[Array, ""]


class PathRow(eqx.Module):
    """Poses of one tooth period, or of several.

    Attributes:
        number: Row of the path at its end, shape (*period,).
        start: At its start, shape (3,).
        middles: In the middle of its sub-steps, shape (substep, 3).
        ends: At their ends, shape (substep, 3).
        stop: At its end, shape (3,).
    """

    number: Int[Array, "*period"]
    start: Pose
    middles: Pose
    ends: Pose
    stop: Pose


class RigidState(eqx.Module):
    """State of a machine that goes where it is told.

    Attributes:
        pose: The pose that is reached.
        chips: Chips in the periods that end at the machine's `chip_row`: those of
            period p at place p modulo `recorded_periods`. A last place takes what is
            not kept. None if no chips are asked for.
    """

    pose: Pose
    chips: TurnChips | None = None


# Periods at least whose chips and forces are kept.
_LEAST_RECORDED = 6


def recorded_periods(process: Process) -> int:
    """Number of periods whose chips and forces are kept."""
    return max(_LEAST_RECORDED, process.cutter.flute_count)


class Rigid(AbstractMachine):
    """A machine that goes where it is told; its command are poses of the tool.

    In a run in segments its command is a `PathPiece`.

    Between the tooth instants the tool goes along a smooth curve through them.

    Attributes:
        keeps_instantaneous: Whether the force at every angle sample is returned.
        chip_row: Row at which the periods end whose chips are returned, at least a
            revolution, shape (); None for none.
    """

    keeps_instantaneous: bool = eqx.field(static=True, default=False)
    chip_row: Int[Array, ""] | None = None

    def begin(self, process: Process, command: Pose | PathPiece) -> RigidState:
        """Return the first pose, and room for chips."""
        start = command.poses[1] if isinstance(command, PathPiece) else command[0]
        if self.chip_row is None:
            return RigidState(start)
        count, substeps = recorded_periods(process), process.engagement.substeps
        middles = start.repeated(substeps)

        def chips() -> TurnChips:
            state = process.begin(start, 1)
            cut = process.engage(state, jnp.ones((), jnp.int32), middles)
            return _turn_chips(process, cut, middles, state.recent)

        room = jax.tree.map(
            lambda x: jnp.zeros((count + 1, *x.shape), x.dtype), jax.eval_shape(chips)
        )
        return RigidState(start, room)

    def rows(
        self, process: Process, command: Pose | PathPiece, row_count: IntScalar | None
    ) -> PathRow:
        """Return the poses of all periods."""
        if isinstance(command, PathPiece):
            poses, first = command.poses, command.first
            within = process.poses_within(poses, command.row_count)
            middles, ends = jax.tree.map(lambda x: x[1:-1], within)
            start, stop = poses[1:-2], poses[2:-1]
        else:
            first = jnp.zeros((), jnp.int32)
            middles, ends = process.poses_within(command, row_count)
            start, stop = command[:-1], command[1:]
        number = first + jnp.arange(1, start.tip.shape[0] + 1, dtype=jnp.int32)
        return PathRow(number, start, middles, ends, stop)

    def pose(self, process: Process, state: RigidState) -> Pose:
        """Return the pose that is reached."""
        del process
        return state.pose

    def joint_positions(self, state: RigidState) -> None:
        """Return None: it has no joints."""
        del state

    def chips(self, state: RigidState) -> TurnChips | None:
        """Return the chips that are kept."""
        return state.chips

    def period(
        self,
        process: Process,
        state: RunState,
        row: PeriodRow,
        access: StockAccess = StockAccess(),
    ) -> tuple[RunState, Period]:
        """State after one tooth period, and its outputs."""
        poses: PathRow = row.command
        before, chips, middles = state.machine, state.machine.chips, poses.middles
        cutting, removed = access.remove(
            process, state.process, row.period - 1, poses.start
        )
        cut, recent = access.engage(process, cutting, row, middles), cutting.recent
        wrench = if_valid(
            row.is_live, lambda: period_wrench(process, cut, middles, recent)
        )
        samples = wrench[:, :3]
        force_range = jax.lax.stop_gradient(
            jnp.stack([jnp.min(samples, axis=0), jnp.max(samples, axis=0)])
        )
        if chips is not None and self.chip_row is not None:
            kept = recorded_periods(process)
            periods_left = self.chip_row - poses.number
            is_kept = (periods_left >= 0) & (periods_left < kept)
            newest = if_valid(
                is_kept, lambda: _turn_chips(process, cut, middles, recent)
            )
            place = jnp.where(is_kept, jnp.mod(poses.number, kept), kept)
            chips = jax.tree.map(lambda x, new: x.at[place].set(new), chips, newest)
        cutting = cutting.ended(middles, poses.ends)
        stop = if_valid(row.is_live, lambda: poses.stop, before.pose)
        return RunState(cutting, RigidState(stop, chips), state.period_count), Period(
            tip=poses.start.tip,
            ends=poses.ends.tip,
            force=jnp.mean(samples, axis=0),
            force_range=force_range,
            spindle_torque=jax.lax.stop_gradient(jnp.mean(wrench[:, 6])),
            joint_positions=None,
            removed=removed,
            has_failed=cutting.has_failed,
            samples=samples if self.keeps_instantaneous else None,
            engagement=cut,
        )


def substep_ranges(
    wrench: Float[Array, "sample 7"], substeps: int
) -> Float[Array, "substep 2 3"]:
    """Least and largest force in each sub-step [N], without derivative.

    Args:
        wrench: Loads at all angles of the period.
        substeps: Sub-steps of the period.
    """
    force = jax.lax.stop_gradient(wrench[:, :3]).reshape(substeps, -1, 3)
    return jnp.stack([jnp.min(force, axis=1), jnp.max(force, axis=1)], axis=1)


def _turn_chips(
    process: Process, cut: Engagement, middles: Pose, recent: Pose
) -> TurnChips:
    """Chips of the teeth in a period whose poses are known, and their force.

    Args:
        process: The process.
        cut: The engagement in the period.
        middles: Poses in the middle of its sub-steps, shape (substep, 3).
        recent: Those of earlier periods, newest first, shape (tooth, substep, 3).
    """
    chip = jax.vmap(
        lambda samples, pose, earlier: process.engagement.chip(
            process, samples, pose, earlier, cut.decimated
        )
    )(cut.samples, middles, process.earlier(recent, middles))
    samples = cut.samples
    chip = jnp.clip(chip, 0, process.cutter.diameter / 2) * samples.chip_share
    force = period_wrench(process, cut, middles, recent)[:, :3]
    return TurnChips(samples.angle, samples.tooth, chip, samples.occupancy, force)


def period_wrench(
    process: Process, cut: Engagement, middles: Pose, recent: Pose
) -> Float[Array, "sample 7"]:
    """Return the loads at all angles of a period whose poses are known.

    Args:
        process: The process.
        cut: The engagement in the period.
        middles: Poses in the middle of its sub-steps, shape (substep, 3).
        recent: Those of earlier periods, newest first, shape (tooth, substep, 3).

    Differentiability: as `AbstractEngagement.wrench`.
    """
    wrench = jax.vmap(
        lambda samples, pose, earlier: process.engagement.wrench(
            process, samples, pose, earlier, cut.decimated
        )
    )
    earlier = process.earlier(recent, middles)
    # What the forces come from is computed again rather than kept.
    return jax.checkpoint(wrench)(cut.samples, middles, earlier).reshape(-1, 7)


def simulate_process(
    positions: FloatRows3,
    stock: Stock,
    cutter: AbstractCutter,
    law: AbstractForceLaw,
    spindle_speed: RealScalarLike,
    axes: FloatRows3 | None = None,
    *,
    engagement: AbstractEngagement | None = None,
    angles: int | None = None,
    axial_depth: float | None = None,
    adjoint: AbstractAdjoint | None = None,
    bottom_law: AbstractForceLaw | None = None,
    keeps_instantaneous: bool = False,
    chip: str = "near_far",
    row_count: IntScalar | None = None,
) -> Run:
    """Cut along a path, one row per tooth period.

    Bottom edges cut where the path descends in material, as in a job of a rigid
    machine; one that swings, with a flat end, has them on request alone, since a swing
    down presses a flat end onto the floor.

    Args:
        positions: Tool tip in `work` at the tooth instants [m], shape (step, 3).
        stock: The raw workpiece.
        cutter: The cutter.
        law: The force law.
        spindle_speed: [rad/s], shape ().
        axes: Tool axis from tip to shank, unit vectors, shape (step, 3); +z if not
            given.
        engagement: As of `choose_engagement`; chosen from `angles`, `axial_depth` and
            `chip` if not given. Of a path or a helix angle that is traced neither depth
            nor steepness is known: what is chosen then is at least as fine, and sums
            differ by the discretisation unless both calls are given one engagement.
        angles: Samples of the immersion angle per revolution.
        axial_depth: Deepest immersion of the tip below the top of the stock [m].
            Taken from the path if that is not traced, else the height of the stock
            or the flutes, whichever is less.
        adjoint: How to differentiate; `ThroughRays()` if not given.
        bottom_law: The law of the bottom edge; derived from `law` if not given.
        keeps_instantaneous: Whether to return the force at every angle sample.
        chip: The chip model: "near_far" is smooth and accurate; "point_cloud" is the
            paper's, hard, only for flat cutters that are upright.
        row_count: How many rows count, those behind leave everything as it is; shape
            (). All rows if not given.

    Returns:
        The forces, volumes and the final stock. Check `.result` for an overflow.

    Raises:
        ValueError: An argument has a wrong shape, an axis is not a unit vector, a law
            has coefficients for another number of teeth, or a point cloud is asked for
            where there is none.

    Differentiability: as `run`. Under a flat end (`dish_angle` 0) a level path is a
    kink in z: the edges begin to push with the square of the descent, and push in full
    from 1 % on, some micrometres per tooth. A hollow end has no such kink. With
    "point_cloud" derivatives exist but are hard: they
    follow the rays that hold the extreme points between the jumps from ray to ray, and
    under `ThroughPoses` ends that earlier poses cut are constants.
    """
    dtype = stock.origin.dtype
    tips = _rows(positions, "positions", dtype)
    axes = _directions(axes, tips.shape[0], dtype)
    if engagement is None:
        immersion = Immersion.of_path(positions, stock, cutter)
        engagement = choose_engagement(
            stock,
            cutter,
            axial_depth=immersion.depth if axial_depth is None else axial_depth,
            angles=angles,
            axes=axes if isinstance(axes, np.ndarray) else None,
            is_upright=axes is None,
            plunges=immersion.plunges,
            chip=chip,
        )
    process = Process(
        stock,
        cutter,
        law,
        spindle_speed,
        engagement,
        bottom_law=bottom_law,
        derivative=adjoint,
    )
    machine = Rigid(keeps_instantaneous)
    return machine.run(process, Pose.along(tips, axes), row_count=row_count)


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
