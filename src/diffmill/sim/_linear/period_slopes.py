"""Slopes of one tooth period: of its forces in the poses, and of the arm in its loads.

Forces follow from poses: of the sub-step itself, of the periods before, of the
decimated older ones, and of the pose at which the stock was looked up. A sample of an
edge depends on the pose of its own sub-step alone, so few derivatives of the look-up do
for all samples at once, and the force takes them by its slope in every sample. Where an
update takes the travel of the whole period, its start and its last predicted pose take
the place of these. The stock is held: how a surface moves with the poses that cut it is
left out, and so are the jumps of a cloud of points from ray to ray.

A pose is a row of 3 numbers, the tip, or of 6 where the tool tilts: tip and axis.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int, PyTree

from ...numerics import Rematerialised, materialise
from ...process import (
    EdgeSamples,
    Engagement,
    Process,
    ProcessState,
)
from ...workpiece import Pose
from .._machine.compliant import AbstractCompliant, CommandRow
from .._machine.machine import PeriodRow


class CuttingMachine(NamedTuple):
    """A machine and what it cuts.

    Attributes:
        machine: The machine.
        process: The process.
    """

    machine: AbstractCompliant
    process: Process


# Machine and process with parameters scaled by the exponentials of some numbers.
ScaledBy: TypeAlias = Callable[
    [CuttingMachine, Float[Array, " parameter"]], CuttingMachine
]


class CompliantModel(eqx.Module):
    """A machine that cuts, as it follows from some parameters.

    Attributes:
        around: Machine and process as they are.
        change: Returns them with scaled parameters; None without parameters.
        count: How many there are.
    """

    around: CuttingMachine
    change: ScaledBy | None
    count: int = eqx.field(static=True)

    def scaled(self, parameters: Float[Array, " parameter"]) -> CuttingMachine:
        """Return machine and process with scaled parameters.

        Args:
            parameters: Logarithms of the factors, shape (parameter,).
        """
        if self.change is None:
            return self.around
        return self.change(self.around, parameters)

    def nominal(self, dtype: DTypeLike) -> Float[Array, " parameter"]:
        """Return the logarithms at which nothing is scaled."""
        return jnp.zeros(self.count, dtype)


class ForceSlopes(eqx.Module):
    """Slopes of the loads on the tool in the sub-steps of one period.

    Attributes:
        now: In the pose of the sub-step, shape (substep, load, pose).
        before: In those when the teeth before passed, shape (substep, load, before,
            pose), of uneven teeth (substep, load, before, tooth, pose).
        newest: In that of the same sub-step of the period before, by what was found in
            the stock, shape (substep, load, pose); None for even teeth, of which it is
            the first of those before.
        decimated: In the decimated older poses, shape (substep, load, circle, pose).
        predicted: In the pose at which the stock was looked up, shape (substep, load,
            pose); in the last one where a look judges the whole period.
        start: In the pose at the start of the period, likewise; None if samples do not
            depend on it.
        parameters: In the parameters of the process, the stock held, shape (substep,
            load, parameter).
        circles: Rows of the decimated poses, shape (circle,).
    """

    now: Float[Array, "substep load pose"]
    before: Float[Array, "substep load *before pose"]
    newest: Float[Array, "substep load pose"] | None
    decimated: Float[Array, "substep load circle pose"]
    predicted: Float[Array, "substep load pose"]
    start: Float[Array, "substep load pose"] | None
    parameters: Float[Array, "substep load parameter"]
    circles: Int[Array, " circle"]


class ArmSlopes(eqx.Module):
    """Slopes of the arm over one period, in its inputs one after the other.

    The inputs are the state at the start, the motors at the start and at the end, the
    loads of the sub-steps, and the parameters of the machine.

    Attributes:
        end: Of the state at the end, shape (state, input).
        pose: Of the pose at the start, shape (pose, input).
        middles: Of the poses in the middle of the sub-steps, shape (substep, pose,
            input).
        ends: Of the tips at their ends, shape (substep, 3, input).
        predicted: Of the poses at which the stock is looked up, as `middles`; None
            where they follow from the period before.
    """

    end: Float[Array, "state input"]
    pose: Float[Array, "pose input"]
    middles: Float[Array, "substep pose input"]
    ends: Float[Array, "substep 3 input"]
    predicted: Float[Array, "substep pose input"] | None


def as_rows(pose: Pose) -> Float[Array, "*pose component"]:
    """Return poses as rows of numbers."""
    if pose.axis is None:
        return pose.tip
    return jnp.concatenate([pose.tip, pose.axis], axis=-1)


def as_poses(rows: Float[Array, "*pose component"]) -> Pose:
    """Return rows of numbers as poses."""
    if rows.shape[-1] == 3:
        return Pose(rows)
    return Pose(rows[..., :3], rows[..., 3:])


class PeriodForce(eqx.Module):
    """Edges and poses from which the slopes of a period's loads follow.

    Attributes:
        samples: The numbers of its edges that follow the poses.
        known: The rest of its edges.
        sample_jvp: The samples' change with the poses that are looked up, with those of
            the period before, and with the tip at the start.
        middles: Poses in the middle of the sub-steps, shape (substep, pose).
        earlier: Those when the teeth before passed, shape (substep, before, pose), of
            uneven teeth (substep, before, tooth, pose).
        decimated: The decimated older poses, shape (circle, pose).
        circles: Their rows, shape (circle,).
    """

    samples: EdgeSamples
    known: EdgeSamples
    sample_jvp: Callable[[Array, Array, Array], EdgeSamples]
    middles: Float[Array, "substep pose"]
    earlier: Float[Array, "substep *before pose"]
    decimated: Float[Array, "circle pose"]
    circles: Int[Array, " circle"]


def engagement_with_slopes(
    process: Process, state: ProcessState, row: PeriodRow, predicted: Pose
) -> Engagement:
    """Return the engagement of a period, with what changes its samples.

    Args:
        process: The process; its derivative holds the stock.
        state: State after the removal of this period.
        row: The period.
        predicted: Poses at which the stock is looked up, shape (substep, 3).
    """
    engagement = process.engagement

    def engage(
        ahead: Array, newest: Array, start: Array
    ) -> tuple[EdgeSamples, tuple[EdgeSamples, Pose]]:
        recent = jax.tree.map(
            lambda rows, first: rows.at[0].set(first), state.recent, as_poses(newest)
        )
        near = eqx.tree_at(lambda s: (s.recent, s.last_tip), state, (recent, start))
        cut = engagement.engage(process, near, row.period, as_poses(ahead))
        samples, known = eqx.partition(cut.samples, cut.samples.follows_poses)
        return samples, (known, cut.decimated)

    engage = Rematerialised.of(engage)
    at = as_rows(predicted), as_rows(state.recent)[0], state.last_tip
    samples, sample_jvp, (known, decimated) = jax.linearize(engage, *at, has_aux=True)
    return Engagement(eqx.combine(samples, known), decimated, sample_jvp)


def period_force(
    process: Process, state: ProcessState, cut: Engagement, middles: Pose
) -> PeriodForce:
    """Edges and poses from which the slopes of a period's loads follow.

    Args:
        process: The process.
        state: State after the removal of this period.
        cut: The engagement, of `engagement_with_slopes`.
        middles: Poses in the middle of the sub-steps, shape (substep, 3).
    """
    assert cut.sample_jvp is not None
    samples, known = eqx.partition(cut.samples, cut.samples.follows_poses)
    circles = process.removal.decimated_rows(state)
    decimated = as_rows(state.track.poses.gather(circles * process.engagement.substeps))
    earlier = as_rows(process.earlier(state.recent, middles))
    return PeriodForce(
        samples, known, cut.sample_jvp, as_rows(middles), earlier, decimated, circles
    )


def force_slopes(
    model: CompliantModel, around: PeriodForce, samples_whole_period: bool
) -> ForceSlopes:
    """Return the slopes of a period's loads.

    Args:
        model: Machine and process; its stock does not count.
        around: What they follow from.
        samples_whole_period: As of the engagement.
    """
    at = model.nominal(around.middles.dtype)
    # A sample of an edge follows the pose of its own sub-step: one motion of all.
    shape = around.middles.shape
    unit = jnp.eye(shape[-1], dtype=around.middles.dtype)
    moves = jnp.broadcast_to(unit[:, None], (shape[-1], *shape))
    still = jnp.zeros_like(moves)
    groups = [(moves, still), (still, moves)]
    if samples_whole_period:
        groups.append((still, still))
    ahead, newest = (jnp.concatenate(rows) for rows in zip(*groups, strict=True))
    start = jnp.zeros((len(ahead), 3), unit.dtype)
    if samples_whole_period:
        start = start.at[-3:].set(jnp.eye(3, dtype=unit.dtype))
    # All together, so that they are compiled once.
    by_either = jax.vmap(around.sample_jvp)(ahead, newest, start)

    def load(
        known: EdgeSamples,
        middle: Array,
        earlier: Array,
        old: Array,
        edges: EdgeSamples,
        parameters: Array,
    ) -> Array:
        machine, process = model.scaled(parameters)
        poses = as_poses(middle), as_poses(earlier), as_poses(old)
        wrench = process.engagement.wrench(process, eqx.combine(edges, known), *poses)
        return jnp.mean(wrench, axis=0)[: machine.load_count]

    def load_slopes(known: EdgeSamples, *inputs: Any) -> tuple[Any, ...]:
        loads, vjp = jax.vjp(functools.partial(load, known), *inputs)
        # What all loads are pulled back through is not computed again for each.
        return jax.vmap(materialise(vjp))(jnp.eye(len(loads), dtype=loads.dtype))

    now, before, decimated, by_edges, by_parameters = jax.vmap(
        load_slopes, (0, 0, 0, None, 0, None)
    )(
        around.known,
        around.middles,
        around.earlier,
        around.decimated,
        around.samples,
        at,
    )
    both = zip(jax.tree.leaves(by_edges), jax.tree.leaves(by_either), strict=True)
    products = [jnp.einsum("sl...,ps...->slp", a, b) for a, b in both]
    slopes = sum(products[1:], products[0])
    by_predicted, by_newest, *by_start = jnp.split(slopes, len(groups), axis=-1)
    is_even = around.earlier.ndim == 3
    return ForceSlopes(
        now=now,
        before=before.at[:, :, 0].add(by_newest) if is_even else before,
        newest=None if is_even else by_newest,
        decimated=decimated,
        predicted=by_predicted,
        start=by_start[0] if by_start else None,
        parameters=by_parameters,
        circles=around.circles,
    )


class LoadedPeriod(NamedTuple):
    """A period of the arm, whose loads are known.

    Attributes:
        state: The arm at the start.
        row: Motors at both ends, shape (joint,).
        loads: Loads of the sub-steps in `work` [N], [N m], shape (substep, load).
    """

    state: PyTree
    row: CommandRow
    loads: Float[Array, "substep load"]


def arm_slopes(model: CompliantModel, period: LoadedPeriod) -> ArmSlopes:
    """Return the slopes of the arm over one period.

    Args:
        model: Machine and process; tooth period and sub-steps of that count.
        period: What the arm did.
    """
    row, loads = period.row, period.loads
    flat, unravel = ravel_pytree(period.state)

    def move(
        x: Array, start: Array, stop: Array, parameters: Array, loads: Array
    ) -> tuple[Array | None, ...]:
        machine, process = model.scaled(parameters)
        row = CommandRow(start, stop)
        moved = machine.motion(process, unravel(x), row, loads)
        poses = moved.pose, moved.middles, Pose(moved.ends), moved.predicted
        rows = [None if x is None else as_rows(x) for x in poses]
        return ravel_pytree(moved.end)[0], *rows

    inputs = flat, row.start, row.stop, model.nominal(flat.dtype), loads
    by_start = jax.jacfwd(move, argnums=(0, 1, 2, 3))(*inputs)
    by_loads = jax.jacfwd(move, argnums=4)(*inputs)

    def join(by_start: tuple[Array, ...], loads: Array) -> Array:
        x, start, stop, parameters = by_start
        loads = loads.reshape(*loads.shape[:-2], -1)
        return jnp.concatenate([x, start, stop, loads, parameters], axis=-1)

    pairs = zip(by_start, by_loads, strict=True)
    joined: list[Any] = [None if b is None else join(a, b) for a, b in pairs]
    return ArmSlopes(*joined)
