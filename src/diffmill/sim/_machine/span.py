"""A machine in one tooth period: sub-steps, pushed by the teeth, and their derivative.

The sub-steps follow each other, since the force of one moves the tip of the next. Their
derivative is found in fewer calls than they are: what does not follow from the tips,
all sub-steps at once; how each force follows its own tip, and of uneven teeth those
before it, as a matrix, all at once too.
One after the other there is only linear motion left. So many small arrays, forward and
back, cost calls rather than arithmetic.
"""

import abc
import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float, Int, PyTree

from ...process import EdgeSamples, Process
from ...workpiece import Pose


class AbstractPeriodDynamics(eqx.Module):
    """A machine in one tooth period, in `work`, ready for its sub-steps.

    Its states are trees of floating arrays.

    Attributes:
        pose: At the start.
    """

    pose: eqx.AbstractVar[Pose]

    @abc.abstractmethod
    def middle(self, state: PyTree, time: Float[Array, ""]) -> Float[Array, " 3"]:
        """Return the tip in the middle of a sub-step, before its force is known [m].

        Args:
            state: The machine's, at the start of the sub-step.
            time: Of its middle, from the start of the period [s].
        """

    @abc.abstractmethod
    def step(
        self, state: PyTree, time: Float[Array, ""], load: Float[Array, " load"]
    ) -> PyTree:
        """Return the state at the end of a sub-step.

        Args:
            state: At its start.
            time: Of its middle, from the start of the period [s].
            load: Force on the tool [N], and its moment about the tip [N m] if the
                machine takes that; held over the sub-step.
        """

    @abc.abstractmethod
    def tip(self, state: PyTree) -> Float[Array, " 3"]:
        """Return the tip in a state of the period [m]."""


class SubstepRow(NamedTuple):
    """What the force of a sub-step, or of several, comes from.

    Attributes:
        time: Its middle, from the start of the period [s], shape (*substep,).
        earlier: Poses when the teeth before passed, shape (*substep, before, 3), of
            uneven teeth (*substep, before, tooth, 3), as if the tool had stood still
            in these sub-steps.
        samples: What is in the cut.
        within: Weights of the ways of these sub-steps in those when the teeth before
            passed, shape (*substep, before, tooth, substep); None for even teeth,
            which passed before all of them.
    """

    time: Float[Array, "*substep"]
    earlier: Pose
    samples: EdgeSamples
    within: Float[Array, "*substep before tooth substep"] | None = None

    def passed(self, ways: Float[Array, "substep 3"] | None) -> Pose:
        """Return the poses when the teeth before passed.

        Args:
            ways: From the tip at the start of the period to those in the middle of
                these sub-steps, as far as they are known, then 0 [m]; they do not
                count for even teeth.
        """
        if self.within is None:
            return self.earlier
        moved = jnp.einsum("kju,ua->kja", self.within, ways, precision="highest")
        return Pose(self.earlier.tip + moved, self.earlier.axis)


class MovedSubstep(NamedTuple):
    """What a sub-step, or several, did.

    Attributes:
        tip: In its middle [m], shape (*substep, 3).
        end: The machine's state at its end.
        load: Force on the tool [N], and its moment about the tip [N m] if the machine
            takes that, shape (*substep, load).
    """

    tip: Float[Array, "*substep 3"]
    end: PyTree
    load: Float[Array, "*substep load"]


class MachinePeriod(eqx.Module):
    """A machine in a period, and the tool that the teeth push.

    Attributes:
        process: The process without its stock.
        span: The machine.
        decimated: Older poses.
        load_count: 3 for the force alone, 6 with its moment.
    """

    process: Process
    span: AbstractPeriodDynamics
    decimated: Pose
    load_count: int = eqx.field(static=True)

    def run(self, start: PyTree, rows: SubstepRow) -> tuple[PyTree, MovedSubstep]:
        """Return the state after some sub-steps, and what each did.

        Args:
            start: The machine's state before the first.
            rows: The sub-steps.

        **Differentiability**: exact, in forward and reverse mode, of any order.
        """
        arrays, fixed = eqx.partition(_Given(self, start, rows), eqx.is_array)
        return _run(fixed, arrays)

    def load(
        self, row: SubstepRow, tip: Float[Array, " 3"], earlier: Pose
    ) -> Float[Array, " load"]:
        """Return the mean load of a sub-step whose tips are known [N], [N m]."""
        pose = Pose(tip, self.span.pose.axis)
        wrench = self.process.engagement.wrench(
            self.process, row.samples, pose, earlier, self.decimated
        )
        return jnp.mean(wrench, axis=0)[: self.load_count]


class _Given(eqx.Module):
    """All that sub-steps follow from."""

    pushed: MachinePeriod
    start: PyTree
    rows: SubstepRow


class _Before(NamedTuple):
    """A machine before a sub-step, or its change, and its way there.

    Attributes:
        state: Of the machine.
        ways: As of `SubstepRow.passed`, shape (substep, 3); None for even teeth, which
            do not look back at them.
        known: How many are known, shape ().
    """

    state: PyTree
    ways: Float[Array, "substep 3"] | None = None
    known: Int[Array, ""] | None = None

    @staticmethod
    def of(state: PyTree, rows: SubstepRow) -> "_Before":
        """Return the machine before the first of some sub-steps."""
        if rows.within is None:
            return _Before(state)
        ways = jnp.zeros((rows.within.shape[-1], 3), rows.within.dtype)
        return _Before(state, ways, jnp.zeros((), jnp.int32))

    def with_way(self, way: Float[Array, " 3"]) -> "_Before":
        """Return the same one sub-step on."""
        if self.ways is None or self.known is None:
            return self
        return _Before(self.state, self.ways.at[self.known].set(way), self.known + 1)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _run(fixed: _Given, arrays: _Given) -> tuple[PyTree, MovedSubstep]:
    given: _Given = eqx.combine(arrays, fixed)
    pushed = given.pushed

    def substep(before: _Before, row: SubstepRow) -> tuple[_Before, MovedSubstep]:
        tip = pushed.span.middle(before.state, row.time)
        before = before.with_way(tip - pushed.span.pose.tip)
        load = pushed.load(row, tip, row.passed(before.ways))
        end = pushed.span.step(before.state, row.time, load)
        return before._replace(state=end), MovedSubstep(tip, end, load)

    begun = _Before.of(given.start, given.rows)
    last, moved = jax.lax.scan(substep, begun, given.rows)
    return last.state, moved


class _SlopeRow(NamedTuple):
    """Changes of a sub-step, or of several, in the direction that is asked for.

    Attributes:
        time: As `SubstepRow`.
        start: The machine's state at its start.
        load: As `MovedSubstep`.
        by_tip: Slope of the load by its tip, the other tips fixed.
        by_tips: Slope of the load by all tips of these sub-steps, with which the teeth
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


def _run_jvp(fixed: _Given, primals: Any, tangents: Any) -> tuple[Any, Any]:
    """Return what the sub-steps do, and how that changes."""
    end, moved = _run(fixed, *primals)
    given: _Given = eqx.combine(primals[0], fixed)
    leaves, tree = jax.tree.flatten(primals[0])
    changes = tree.flatten_up_to(tangents[0])
    moving = [i for i, x in enumerate(changes) if not isinstance(x, SymbolicZero)]
    along = [leaves[i] for i in moving], [changes[i] for i in moving]

    def with_values(values: list[Array]) -> _Given:
        whole = list(leaves)
        for i, value in zip(moving, values, strict=True):
            whole[i] = value
        return eqx.combine(jax.tree.unflatten(tree, whole), fixed)

    states = jax.tree.map(
        lambda x, y: jnp.concatenate([x[None], y[:-1]]), given.start, moved.end
    )

    def motion(values: list[Array]) -> tuple[PyTree, Array, PyTree]:
        now = with_values(values)
        span, time = now.pushed.span, now.rows.time
        ends = jax.vmap(span.step)(states, time, moved.load)
        return now.start, jax.vmap(span.middle)(states, time), ends

    # Reverse mode computes it again rather than keep what it takes.
    @jax.checkpoint
    def loads(values: list[Array], tips: Float[Array, "substep 3"]) -> Array:
        now = with_values(values)
        ways = tips - now.pushed.span.pose.tip[None]
        load = lambda row, tip: now.pushed.load(row, tip, row.passed(ways))
        return jax.vmap(load)(now.rows, tips)

    # All sub-steps at once: what does not follow from the states and tips on the way.
    _, (start, middles, ends) = jax.jvp(motion, along[:1], along[1:])
    of_values = lambda values: loads(values, moved.tip)
    _, own_loads = jax.jvp(of_values, along[:1], along[1:])
    ways = moved.tip - given.pushed.span.pose.tip[None]
    by_tip = jax.vmap(
        lambda row, tip: jax.jacfwd(given.pushed.load, argnums=1)(
            row, tip, row.passed(ways)
        )
    )(given.rows, moved.tip)
    by_tips = _by_tips(given, moved.tip, ways)
    span = given.pushed.span

    def substep(before: _Before, row: _SlopeRow) -> tuple[_Before, MovedSubstep]:
        middle = lambda state: span.middle(state, row.time)
        step = lambda state, load: span.step(state, row.time, load)
        _, tip = jax.jvp(middle, (row.start,), (before.state,))
        tip = tip + row.own_middle
        load = row.own_load + row.by_tip @ tip
        before = before.with_way(tip)
        if row.by_tips is not None and before.ways is not None:
            load = load + jnp.tensordot(row.by_tips, before.ways, 2)
        _, end = jax.jvp(step, (row.start, row.load), (before.state, load))
        end = jax.tree.map(jnp.add, end, row.own_end)
        return before._replace(state=end), MovedSubstep(tip, end, load)

    rows = _SlopeRow(
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
    return (end, moved), (last.state, changes)


def _by_tips(
    given: _Given, tips: Float[Array, "substep 3"], ways: Float[Array, "substep 3"]
) -> Float[Array, "substep load substep 3"] | None:
    """Return how loads follow the tips with which the teeth before passed."""
    if given.rows.within is None:
        return None

    def slopes(row: SubstepRow, tip: Float[Array, " 3"]) -> Array:
        passed = row.passed(ways)
        load = lambda old: given.pushed.load(row, tip, Pose(old, passed.axis))
        # There are fewer loads than teeth before.
        by_passed = jax.jacrev(load)(passed.tip)
        return jnp.einsum("lkja,kju->lua", by_passed, row.within)

    return jax.vmap(slopes)(given.rows, tips)


_run.defjvp(_run_jvp, symbolic_zeros=True)
