"""A machine in one tooth period: sub-steps, pushed by the teeth, and their derivative.

The sub-steps follow each other, since the force of one moves the tip of the next. Their
derivative is batched: the partial derivatives of loads and states are evaluated for all
sub-steps at once, the load's in its own tip and, for uneven teeth, in the tips before
as matrices; a linear scan then propagates the tip. One sub-step after the other there
is only linear motion left: many small calls, forward and back, would cost more than
their arithmetic.
"""

import abc
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float, Int, PyTree

from ...process import EdgeSamples, Engagement, Process, Substeps
from ...workpiece import Pose
from .machine import LoadedSubsteps


class AbstractPeriodDynamics(eqx.Module):
    """A machine in one tooth period, in `work`, ready for its sub-steps.

    Its states are trees of floating arrays.

    Attributes:
        pose: At the start.
    """

    pose: eqx.AbstractVar[Pose]

    @abc.abstractmethod
    def middle(self, state: PyTree, time: Float[Array, ""]) -> Float[Array, " 3"]:
        """Tip in the middle of a sub-step, before its force is known [m].

        Args:
            state: The machine's, at the start of the sub-step.
            time: Of its middle, from the start of the period [s].
        """

    @abc.abstractmethod
    def step(
        self, state: PyTree, time: Float[Array, ""], load: Float[Array, " load"]
    ) -> PyTree:
        """State at the end of a sub-step.

        Args:
            state: At its start.
            time: Of its middle, from the start of the period [s].
            load: Force on the tool [N], and its moment about the tip [N m] if the
                machine takes that; held over the sub-step.
        """

    @abc.abstractmethod
    def tip(self, state: PyTree) -> Float[Array, " 3"]:
        """Tip in a state of the period [m]."""


class SubstepRow(NamedTuple):
    """Cause of the force of a sub-step, or of several.

    Attributes:
        time: Its middle, from the start of the period [s], shape (*substep,).
        earlier: Poses when the teeth before passed, shape (*substep, before, 3), of
            uneven teeth (*substep, before, tooth, 3), as if the tool had rested
            in these sub-steps.
        within: Weights of this period's displacements in the poses when the teeth
            before passed, shape (*substep, before, tooth, substep); None for evenly
            spaced teeth, which passed before all of them.
        samples: The edges in the cut; None before the engagement is known.
    """

    time: Float[Array, "*substep"]
    earlier: Pose
    within: Float[Array, "*substep before tooth substep"] | None
    samples: EdgeSamples | None = None

    def passed(self, displacement: Float[Array, "substep 3"] | None) -> Pose:
        """Poses when the teeth before passed.

        Args:
            displacement: From the tip at the start of the period to those in the middle
                of these sub-steps, as far as they are known, then 0 [m]; it does not
                count for even teeth.
        """
        if self.within is None:
            return self.earlier
        moved = jnp.einsum(
            "kju,ua->kja", self.within, displacement, precision="highest"
        )
        return Pose(self.earlier.tip + moved, self.earlier.axis)

    def part(
        self, first: Int[Array, ""], displacement: Float[Array, "substep 3"], count: int
    ) -> "SubstepRow":
        """Some sub-steps of a period, when those before them are known.

        Args:
            first: Index of the first one, shape ().
            displacement: As of `passed`, of all sub-steps of the period.
            count: How many they are.
        """
        cut = lambda x, axis: jax.lax.dynamic_slice_in_dim(x, first, count, axis)
        time = cut(self.time, 0)
        earlier = jax.tree.map(lambda x: cut(x, 0), self.earlier)
        if self.within is None:
            return SubstepRow(time, earlier, None)
        within = cut(self.within, 0)
        moved = jnp.einsum("skju,ua->skja", within, displacement, precision="highest")
        earlier = Pose(earlier.tip + moved, earlier.axis)
        return SubstepRow(time, earlier, cut(within, 3))


class CoupledPeriod(eqx.Module):
    """A machine in a period, pushed by the teeth.

        tip_s = middle(x_s),  F_s = F(tip_s, tips of the teeth before),
        x_{s+1} = step(x_s, F_s)

    # symbols: s sub-step, x state of the machine, F mean load of a sub-step

    Attributes:
        process: The process without its stock, which a force does not depend on.
        dynamics: The machine.
        load_count: 3 for the force alone, 6 with its moment.
    """

    process: Process
    dynamics: AbstractPeriodDynamics
    load_count: int = eqx.field(static=True)

    def __init__(
        self, process: Process, dynamics: AbstractPeriodDynamics, load_count: int
    ):
        """Couple the teeth of a process to a machine."""
        self.process = eqx.tree_at(lambda p: p.stock, process, None)
        self.dynamics, self.load_count = dynamics, load_count

    def rows(self, time: Float[Array, " substep"], recent: Pose) -> SubstepRow:
        """Sub-steps of the period, before their engagement is known.

        Args:
            time: The middle of each from the start of the period [s].
            recent: Poses in the periods before, newest first, shape (tooth, substep,
                3).
        """
        still = self.dynamics.pose.repeated(recent.tip.shape[1])
        teeth = self.process.teeth_before(recent.tip.dtype)
        within = None if teeth is None else teeth.within
        return SubstepRow(time, self.process.earlier(recent, still), within)

    def standstill(self, predicted: Pose) -> LoadedSubsteps:
        """Sub-steps in which nothing moves, of a period that does not count."""
        tip = self.dynamics.pose.tip
        ends = jnp.broadcast_to(tip[None], predicted.tip.shape)
        loads = jnp.zeros((ends.shape[0], self.load_count), ends.dtype)
        none = jnp.zeros((ends.shape[0], 2, 3), ends.dtype)
        return LoadedSubsteps(
            predicted.tip, predicted.tip, ends, loads, none, none[:, 0, 0]
        )

    def run(
        self, start: PyTree, rows: SubstepRow, predicted: Pose, cut: Engagement
    ) -> tuple[PyTree, LoadedSubsteps]:
        """State after some sub-steps, and these.

        Args:
            start: The machine's state before the first.
            rows: The sub-steps.
            predicted: Poses at which their engagement was looked up, shape (substep,
                3).
            cut: The engagement there.

        **Differentiability**: exact, in forward and reverse mode, of any order.
        """
        given = _PeriodInputs(
            self, start, rows._replace(samples=cut.samples), cut.decimated
        )
        arrays, fixed = eqx.partition(given, eqx.is_array)
        end, moved = _run(fixed, arrays)
        ends = jax.vmap(self.dynamics.tip)(moved.end)
        tips = predicted.tip, moved.tip, ends
        recorded = moved.force_range, moved.spindle_torque
        return end, LoadedSubsteps(*tips, moved.load, *recorded)

    def run_with_updates(
        self,
        engage: Callable[[Pose, Pose, Substeps], Engagement],
        start: PyTree,
        rows: SubstepRow,
        recent: Pose,
        drift: Float[Array, "1 3"],
    ) -> tuple[PyTree, LoadedSubsteps]:
        """State after the period, and its sub-steps; the stock looked up repeatedly.

        Where a period is long, a machine swings within it, and the period before does
        not tell where the tool will be in its later sub-steps.

        Args:
            engage: Returns the engagement of some sub-steps, from the poses of the
                periods before in them, their predicted poses, and which they are.
            start: The machine's state.
            rows: The sub-steps.
            recent: As of `rows`.
            drift: From the tip of the period before to that at the start [m].

        **Differentiability**: as `run`.
        """
        updates = self.process.engagement.updates_per_period
        count = self.process.engagement.substeps // updates
        pose = self.dynamics.pose

        def update(carry, part):
            state, offset, displacement = carry
            first, recent = part
            predicted = along(pose, recent.tip[0] + offset)
            cut = engage(recent, predicted, Substeps(first, count))
            own = rows.part(first, displacement, count)
            state, moved = self.run(state, own, predicted, cut)
            if own.within is not None:
                displacement = jax.lax.dynamic_update_slice_in_dim(
                    displacement, moved.tips - pose.tip[None], first, 0
                )
            # How far the tool is off the period before goes on changing as it did.
            off = moved.tips - recent.tip[0]
            later = jnp.arange(1, count + 1, dtype=off.dtype)[:, None]
            offset = off[-1:] + later * (off[-1:] - off[-2:-1])
            return (state, offset, displacement), moved

        split = lambda x: x.reshape(updates, count, *x.shape[1:])
        parts = jax.tree.map(lambda x: jnp.swapaxes(jax.vmap(split)(x), 0, 1), recent)
        first = count * jnp.arange(updates, dtype=jnp.int32)
        offset = jnp.broadcast_to(drift, (count, 3))
        begun = start, offset, jnp.zeros_like(recent.tip[0])
        (end, _, _), moved = jax.lax.scan(update, begun, (first, parts))
        return end, jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), moved)


class _MovedSubstep(NamedTuple):
    """Motion of a sub-step, or of several, or its change.

    Attributes:
        tip: In its middle [m], shape (*substep, 3).
        end: The machine's state at its end.
        load: Force on the tool [N], and its moment about the tip [N m] if the machine
            takes that, shape (*substep, load).
        force_range: Least and largest force at any angle [N], shape (*substep, 2, 3);
            without derivative.
        spindle_torque: That the spindle needs [N m], shape (*substep,), likewise.
    """

    tip: Float[Array, "*substep 3"]
    end: PyTree
    load: Float[Array, "*substep load"]
    force_range: Float[Array, "*substep 2 3"] | None = None
    spindle_torque: Float[Array, "*substep"] | None = None


class _PeriodInputs(eqx.Module):
    """Machine, start state, edge samples and older poses of one run of sub-steps."""

    coupled: CoupledPeriod
    start: PyTree
    rows: SubstepRow
    decimated: Pose

    def load(
        self, row: SubstepRow, tip: Float[Array, " 3"], earlier: Pose
    ) -> Float[Array, " load"]:
        """Mean load F of a sub-step whose tips are known [N], [N m]."""
        return self.mean(self.wrench(row, tip, earlier))

    def mean(self, wrench: Float[Array, "angle 7"]) -> Float[Array, " load"]:
        """Mean load of a sub-step on the machine, from those at its angles."""
        return jnp.mean(wrench, axis=0)[: self.coupled.load_count]

    def wrench(
        self, row: SubstepRow, tip: Float[Array, " 3"], earlier: Pose
    ) -> Float[Array, "angle 7"]:
        """Loads of the tool at the angles of a sub-step [N], [N m].

        Args:
            row: The sub-step.
            tip: In its middle [m].
            earlier: Poses when the teeth before passed.
        """
        coupled, samples = self.coupled, row.samples
        assert samples is not None
        pose = Pose(tip, coupled.dynamics.pose.axis)
        return coupled.process.engagement.wrench(
            coupled.process, samples, pose, earlier, self.decimated
        )


class _Before(NamedTuple):
    """State of a machine before a sub-step, or its change, and its displacements.

    Attributes:
        state: Of the machine.
        displacement: As of `SubstepRow.passed`, shape (substep, 3); None for even
            teeth, whose force does not depend on it.
        known: How many sub-steps it is known of, shape ().
    """

    state: PyTree
    displacement: Float[Array, "substep 3"] | None = None
    known: Int[Array, ""] | None = None

    @staticmethod
    def of(state: PyTree, rows: SubstepRow) -> "_Before":
        """State before the first of some sub-steps."""
        if rows.within is None:
            return _Before(state)
        displacement = jnp.zeros((rows.within.shape[-1], 3), rows.within.dtype)
        return _Before(state, displacement, jnp.zeros((), jnp.int32))

    def with_displacement(self, next_one: Float[Array, " 3"]) -> "_Before":
        """The same with the displacement of the sub-step [m]."""
        if self.displacement is None or self.known is None:
            return self
        displacement = self.displacement.at[self.known].set(next_one)
        return _Before(self.state, displacement, self.known + 1)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _run(fixed: _PeriodInputs, arrays: _PeriodInputs) -> tuple[PyTree, _MovedSubstep]:
    """The sub-steps of a period, one after the other: tip, load, step."""
    given: _PeriodInputs = eqx.combine(arrays, fixed)
    dynamics = given.coupled.dynamics

    def substep(before: _Before, row: SubstepRow) -> tuple[_Before, _MovedSubstep]:
        tip = dynamics.middle(before.state, row.time)
        before = before.with_displacement(tip - dynamics.pose.tip)
        wrench = given.wrench(row, tip, row.passed(before.displacement))
        load = given.mean(wrench)
        end = dynamics.step(before.state, row.time, load)
        force = wrench[:, :3]
        force_range = jnp.stack([jnp.min(force, axis=0), jnp.max(force, axis=0)])
        torque = jnp.mean(wrench[:, 6])
        moved = _MovedSubstep(tip, end, load, force_range, torque)
        return before._replace(state=end), moved

    begun = _Before.of(given.start, given.rows)
    last, moved = jax.lax.scan(substep, begun, given.rows)
    return last.state, moved


class _LinearSubstep(NamedTuple):
    """Partial derivatives of a sub-step, or of several, in one direction.

    Attributes:
        time: As `SubstepRow`.
        start: The machine's state at its start.
        load: As `_MovedSubstep`.
        by_tip: Slope of the load in its tip, the other tips fixed.
        by_tips: Slope of the load in all tips of these sub-steps, with which the teeth
            before passed; None for even teeth.
        own_middle: Change of the tip in the middle, the state at the start fixed.
        own_end: Change of the state at the end, that at the start and the load fixed.
        own_load: Change of the load, the tips fixed.
    """

    time: Float[Array, "*substep"]
    start: PyTree
    load: Float[Array, "*substep load"]
    by_tip: Float[Array, "*substep load 3"]
    by_tips: Float[Array, "*substep load substep 3"] | None
    own_middle: Float[Array, "*substep 3"]
    own_end: PyTree
    own_load: Float[Array, "*substep load"]


def _run_jvp(fixed: _PeriodInputs, primals: Any, tangents: Any) -> tuple[Any, Any]:
    """JVP of the sub-steps."""
    end, moved = _run(fixed, *primals)
    given: _PeriodInputs = eqx.combine(primals[0], fixed)
    leaves, tree = jax.tree.flatten(primals[0])
    changes = tree.flatten_up_to(tangents[0])
    moving = [i for i, x in enumerate(changes) if not isinstance(x, SymbolicZero)]
    values, value_changes = [leaves[i] for i in moving], [changes[i] for i in moving]

    def with_values(values: list[Array]) -> _PeriodInputs:
        whole = list(leaves)
        for i, value in zip(moving, values, strict=True):
            whole[i] = value
        return eqx.combine(jax.tree.unflatten(tree, whole), fixed)

    states = jax.tree.map(
        lambda x, y: jnp.concatenate([x[None], y[:-1]]), given.start, moved.end
    )

    def motion(values: list[Array]) -> tuple[PyTree, Array, PyTree]:
        now = with_values(values)
        dynamics, time = now.coupled.dynamics, now.rows.time
        ends = jax.vmap(dynamics.step)(states, time, moved.load)
        return now.start, jax.vmap(dynamics.middle)(states, time), ends

    # Reverse mode computes it again rather than keep what it takes.
    @jax.checkpoint
    def loads(values: list[Array]) -> Array:
        now = with_values(values)
        displacement = moved.tip - now.coupled.dynamics.pose.tip[None]
        load = lambda row, tip: now.load(row, tip, row.passed(displacement))
        return jax.vmap(load)(now.rows, moved.tip)

    # Batched over the sub-steps: all partial derivatives with states and tips fixed.
    _, (start, middles, ends) = jax.jvp(motion, (values,), (value_changes,))
    _, own_loads = jax.jvp(loads, (values,), (value_changes,))
    dynamics = given.coupled.dynamics
    displacement = moved.tip - dynamics.pose.tip[None]
    slope = jax.jacfwd(given.load, argnums=1)
    by_tip = jax.vmap(lambda row, tip: slope(row, tip, row.passed(displacement)))(
        given.rows, moved.tip
    )

    def by_passed(row: SubstepRow, tip: Float[Array, " 3"]) -> Array:
        passed = row.passed(displacement)
        load = lambda old: given.load(row, tip, Pose(old, passed.axis))
        # There are fewer loads than teeth before.
        return jnp.einsum("lkja,kju->lua", jax.jacrev(load)(passed.tip), row.within)

    is_even = given.rows.within is None
    by_tips = None if is_even else jax.vmap(by_passed)(given.rows, moved.tip)

    def substep(before: _Before, row: _LinearSubstep) -> tuple[_Before, _MovedSubstep]:
        middle = lambda state: dynamics.middle(state, row.time)
        step = lambda state, load: dynamics.step(state, row.time, load)
        _, tip = jax.jvp(middle, (row.start,), (before.state,))
        tip = tip + row.own_middle
        load = row.own_load + row.by_tip @ tip
        before = before.with_displacement(tip)
        if row.by_tips is not None and before.displacement is not None:
            load = load + jnp.tensordot(row.by_tips, before.displacement, 2)
        _, end = jax.jvp(step, (row.start, row.load), (before.state, load))
        end = jax.tree.map(jnp.add, end, row.own_end)
        return before._replace(state=end), _MovedSubstep(tip, end, load)

    rows = _LinearSubstep(
        time=given.rows.time,
        start=states,
        load=moved.load,
        by_tip=by_tip,
        by_tips=by_tips,
        own_middle=middles,
        own_end=ends,
        own_load=own_loads,
    )
    last, changes = jax.lax.scan(substep, _Before.of(start, given.rows), rows)
    changes = changes._replace(
        force_range=jnp.zeros_like(moved.force_range),
        spindle_torque=jnp.zeros_like(moved.spindle_torque),
    )
    return (end, moved), (last.state, changes)


_run.defjvp(_run_jvp, symbolic_zeros=True)


def along(pose: Pose, tips: Float[Array, "substep 3"]) -> Pose:
    """Poses at other tips: within a period the tool does not tilt."""
    if pose.axis is None:
        return Pose(tips)
    return Pose(tips, jnp.broadcast_to(pose.axis[None], tips.shape))
