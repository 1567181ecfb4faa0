"""The run as a linear, time-varying system, period by period.

Around a simulated run a change of the motors moves the arm, the arm moves the tips, the
tips change the forces, and the forces move the arm:

    f = L (x, theta_0, theta_1, r, h, p, c)      loads of the sub-steps of a period
    (x', m, e) = A (x, theta_0, theta_1, f, c)   the arm after it, tips on the way

x the arm at the start, theta the motors at both ends, r the poses of the sub-steps in
the periods before, h the decimated older poses, p the pose one period ago, c parameters
of machine and cut, such as stiffness and force coefficients. That the force
of a sub-step follows its own tip, and that tip the forces before, is solved in each
period once. One recurrence then carries any number of directions at once.

The stock is held: how a surface moves with the poses that cut it is left out.
"""

import functools
import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int, Shaped

from ..._padding import if_valid, live_rows, scan_rows
from ..._types import IntScalar
from ...process import AbstractEngagement, Process
from .._machine.compliant import AbstractCompliant
from .._machine.machine import (
    PeriodRow,
    RunState,
    StockAccess,
    all_ends,
    begin,
    continued,
    prepend_zeros,
)
from .period_slopes import (
    ArmSlopes,
    CompliantModel,
    CuttingMachine,
    ForceSlopes,
    LoadedPeriod,
    ScaledBy,
    arm_slopes,
    engagement_with_slopes,
    force_slopes,
    period_force,
)

# Periods of which the slopes of the forces are computed at a time: alone, a period is
# so small that what it costs is calls, and more of them leave the cache.
_BATCH = 4
# Batches that are left out together behind the rows that count.
_TOGETHER = 16


class RunChange(eqx.Module):
    """Changes of a run, in some directions.

    Attributes:
        ends: Of the tips at the ends of the sub-steps of the period before each row
            [m], shape (step, substep, 3, direction); row 0 is at rest.
        force: Of the mean forces over the period before each row [N], shape (step, 3,
            direction).
    """

    ends: Float[Array, "step substep 3 direction"]
    force: Float[Array, "step 3 direction"]


class WallChange(eqx.Module):
    """Changes of a run where it makes the walls, in some directions.

    Attributes:
        tips: Of the tips when the wall of each row is made [m], shape (step, 3,
            direction); row 0 is at rest.
        force: Of the mean forces over the period before each row [N], shape (step, 3,
            direction).
    """

    tips: Float[Array, "step 3 direction"]
    force: Float[Array, "step 3 direction"]


class StateChange(NamedTuple):
    """Changes of the state at the start of a period, in some directions.

    Attributes:
        state: Of the arm, shape (state, direction).
        recent: Of the poses of the periods before, shape (tooth, substep, pose,
            direction).
        before: Of the pose one period ago, shape (pose, direction).
        history: Of all poses at the starts of periods, shape (period, pose,
            direction).
    """

    state: Array
    recent: Array
    before: Array
    history: Array


class LinearRun(eqx.Module):
    """The linear system around a run.

    Attributes:
        ends: Tips of the run itself at the ends of the sub-steps of the period before
            each row [m], shape (step, substep, 3).
        force: Its mean forces over the period before each row [N], shape (step, 3).
        loads: L, shape (period, load, cause).
        arm: A, shape (period, output, input).
        pose: Of the pose at the start of a period in x, shape (period, pose, state).
        circles: Rows of the decimated poses, shape (period, circle); those before the
            first row, which stay, are negative.
        begin: Of the first state in the first three motor positions and in the
            parameters, shape (state, 3 joint + parameter).
        periods: Teeth whose poses a force remembers.
        substeps: Sub-steps of a period.
    """

    ends: Float[Array, "step substep 3"]
    force: Float[Array, "step 3"]
    loads: Float[Array, "period load cause"]
    arm: Float[Array, "period output input"]
    pose: Float[Array, "period pose state"]
    circles: Int[Array, "period circle"]
    begin: Float[Array, "state first"]
    periods: int = eqx.field(static=True)
    substeps: int = eqx.field(static=True)

    def move(
        self,
        motors: Float[Array, "step joint direction"],
        parameters: Float[Array, "parameter direction"] | None = None,
    ) -> RunChange:
        """Change of the run with its motors and parameters.

        Args:
            motors: Changes of the motor positions [rad or m], shape (step, joint,
                direction).
            parameters: Relative changes of the parameters, shape (parameter,
                direction); None for a system without any.

        **Differentiability**: linear.
        """
        directions = motors.shape[-1]
        if parameters is None:
            parameters = jnp.zeros((0, directions), motors.dtype)
        start = self._initial_change(motors, parameters)
        rows = (
            jnp.arange(motors.shape[0] - 1, dtype=jnp.int32),
            *(self.loads, self.arm, self.pose, self.circles, motors[:-1], motors[1:]),
        )

        def period(state, row):
            return self._period(state, row, parameters)

        _, (ends, force) = jax.lax.scan(period, start, rows)
        first = start.before
        rest = jnp.broadcast_to(first[None, None, :3], (1, *ends.shape[1:]))
        still = jnp.zeros((1, 3, directions), force.dtype)
        return RunChange(jnp.concatenate([rest, ends]), jnp.concatenate([still, force]))

    def move_walls(
        self,
        motors: Float[Array, "step joint direction"],
        shares: Float[Array, " step"],
    ) -> WallChange:
        """Change of the tips at the instants at which walls are made.

        What `move` says of them, for less: it begins where the motors first change, and
        keeps of each period one tip instead of all.

        Args:
            motors: Changes of the motor positions [rad or m], shape (step, joint,
                direction).
            shares: Share of the period before each row at which its wall is made, from
                0 to 1, shape (step,).

        **Differentiability**: linear; forward mode only.
        """
        steps, _, directions = motors.shape
        start = self._initial_change(motors, jnp.zeros((0, directions), motors.dtype))
        # Between two ends of sub-steps the tip goes straight on.
        nodes = jnp.arange(self.substeps + 1, dtype=motors.dtype)
        away = jnp.abs(shares[:, None] * self.substeps - nodes[None])
        weights = jnp.maximum(1 - away, 0)
        rest = jnp.broadcast_to(start.before[None, :3], (1, 3, directions))
        walls = jnp.zeros((steps, 3, directions), motors.dtype).at[:1].set(rest)

        def period(index, carry):
            state, last, walls, forces = carry
            of = lambda rows: jax.lax.dynamic_index_in_dim(rows, index, keepdims=False)
            row = (
                index,
                *(of(x) for x in (self.loads, self.arm, self.pose, self.circles)),
                *(of(motors), of(motors[1:])),
            )
            state, (ends, force) = self._period(state, row, motors[:0, 0])
            tips = jnp.concatenate([last[None], ends])
            wall = jnp.tensordot(weights[index + 1], tips, 1)
            walls, forces = (
                walls.at[index + 1].set(wall),
                forces.at[index + 1].set(force),
            )
            return state, ends[-1], walls, forces

        # The first state follows from three rows.
        begin = jnp.argmax(jnp.any(motors != 0, axis=(1, 2))).astype(jnp.int32)
        begin = jnp.where(begin < 3, 0, begin - 1)
        carry = start, rest[0], walls, jnp.zeros_like(walls)
        *_, walls, forces = jax.lax.fori_loop(begin, steps - 1, period, carry)
        return WallChange(walls, forces)

    def _initial_change(
        self,
        motors: Float[Array, "step joint direction"],
        parameters: Float[Array, "parameter direction"],
    ) -> StateChange:
        """Return the change of the state in which a run begins."""
        directions = motors.shape[-1]
        head = motors[:3].reshape(-1, directions)
        x = self.begin @ jnp.concatenate([head, parameters])
        first = self.pose[0] @ x
        size = self.periods, self.substeps, *first.shape
        r = jnp.broadcast_to(first[None, None], size)
        # The last row stands for those before the first, which do not move.
        history = jnp.zeros((motors.shape[0], *first.shape), x.dtype)
        return StateChange(x, r, first, history)

    def _period(
        self, state: StateChange, row: tuple[Array, ...], parameters: Array
    ) -> tuple[StateChange, tuple[Array, Array]]:
        """Return the change of the state, of the tips and of the force of a period."""
        x, r, before, history = state
        index, loads, arm, pose, circles, start, stop = row
        S, d, directions = self.substeps, before.shape[0], before.shape[1]
        p = pose @ x
        history = history.at[index].set(p)
        old = history[circles].reshape(-1, directions)
        inputs = [x, start, stop, r.reshape(-1, directions), old, before]
        f = loads @ jnp.concatenate([*inputs, parameters])
        out = arm @ jnp.concatenate([x, start, stop, f, parameters])
        n = x.shape[0]
        x, m, e = jnp.split(out, [n, n + S * d])
        r = jnp.concatenate([m.reshape(1, S, d, directions), r[:-1]])
        force = jnp.mean(f.reshape(S, -1, directions)[:, :3], axis=0)
        return StateChange(x, r, p, history), (e.reshape(S, 3, directions), force)

    def pull(
        self, weights: RunChange
    ) -> tuple[
        Float[Array, "step joint direction"], Float[Array, "parameter direction"]
    ]:
        """Gradient of weighted sums of the run's changes (vector-Jacobian product).

        The transpose of `move`, by one recurrence from the last period to the first.

        Args:
            weights: A weight of every change, in some directions.

        Returns:
            Slopes of the sums in the motor positions, shape (step, joint, direction),
            and in the parameters, shape (parameter, direction).

        **Differentiability**: linear.
        """
        steps, directions = weights.force.shape[0], weights.force.shape[-1]
        n, heads = self.begin.shape
        inputs, loads = self.arm.shape[2], self.loads.shape[1]
        # The first state follows from three rows of the motors and the parameters, a
        # period from two rows, the parameters, the state and the loads.
        joints = heads - (inputs - n - loads)
        shapes = (steps, joints, directions), (heads - 3 * joints, directions)
        of = [jax.ShapeDtypeStruct(x, self.arm.dtype) for x in shapes]
        motors, parameters = jax.linear_transpose(self.move, *of)(weights)
        return motors, parameters

    @classmethod
    def needed_bytes(
        cls,
        machine: AbstractCompliant,
        process: Process,
        motors: Float[Array, "step joint"],
        parameter_count: int = 0,
    ) -> int:
        """Memory that the system of a run takes, before it is run [byte].

        Arguments as of `linearise`; of the motors only the shape counts.
        """
        steps, joints = motors.shape
        state = jax.eval_shape(lambda x: machine.begin(process, x), motors)
        n = sum(math.prod(x.shape) for x in jax.tree.leaves(state))
        S, T = process.engagement.substeps, process.cutter.flute_count
        d = 3 if process.engagement.is_upright else 6
        free, c = S * machine.load_count, parameter_count
        circles = process.removal.circle_count
        known = n + 2 * joints + c
        loads = free * (known + d * (S * T + circles + 1))
        arm = (n + S * (d + 3)) * (known + free)
        rows = (steps - 1) * (loads + arm + d * n) + steps * 3 * (S + 1)
        numbers = rows + n * (3 * joints + c)
        pointers = (steps - 1) * circles
        size = jnp.dtype(motors.dtype).itemsize
        return numbers * size + pointers * jnp.dtype(jnp.int32).itemsize


def linearise(
    machine: AbstractCompliant,
    process: Process,
    motors: Float[Array, "step joint"],
    state: RunState | None = None,
    *,
    scaled: ScaledBy | None = None,
    parameter_count: int = 0,
    row_count: IntScalar | None = None,
) -> LinearRun:
    """Run a machine, and return the linear system around the run.

    Args:
        machine: The machine.
        process: The process; its derivative must hold the stock.
        motors: Motor positions [rad or m], shape (step, joint).
        state: State at row 0, which does not move, of `begin_run` or an earlier
            segment; None to begin with the motors.
        scaled: Called with a named tuple of `machine` and `process` and with some
            numbers, shape (parameter,); returns the tuple with parameters scaled by
            their exponentials. None without parameters. A state that is given does not
            follow them.
        parameter_count: How many parameters there are.
        row_count: How many rows count, shape (); None for all.

    Returns:
        The system, with the run itself; of rows that do not count nothing is known.

    **Differentiability**: none is meant.
    """
    steps, first = motors.shape[0], jnp.ones((), jnp.int32)
    model = CompliantModel(CuttingMachine(machine, process), scaled, parameter_count)
    if state is None:
        started = begin(machine, process, motors, steps)
    else:
        started, first = continued(process, state, steps - 1)

    access = StockAccess(engagement_with_slopes)

    def period(state: RunState, row: PeriodRow):
        ended, out = machine.period(process, state, row, access)
        substeps, cut, out = out.substeps, out.engagement, out.recorded()
        assert substeps is not None
        before, after = state.process, ended.process
        # As the period saw it, before its own poses became the most recent.
        near = eqx.tree_at(
            lambda s: (s.recent, s.ends), after, (before.recent, before.ends)
        )
        middles = after.recent[0]
        if cut is None:
            predicted = eqx.tree_at(lambda p: p.tip, middles, substeps.predicted)
            cut = engagement_with_slopes(process, near, row, predicted)
        force = period_force(process, near, cut, middles)
        arm = LoadedPeriod(state.machine, row.command, substeps.loads)
        return ended, (out, arm, force)

    def batch(state: RunState, rows: PeriodRow, _: Any):
        ended, (out, arm, force) = jax.lax.scan(period, state, rows)
        of = lambda x: force_slopes(model, x, process.engagement.samples_whole_period)
        # `if_valid` asks for its shapes first: under `jit` it is traced once.
        batch_of = jax.jit(jax.vmap(of))
        # Where nothing acts on the tool, moving it changes no force: in the air, which
        # is much of most programs.
        is_loaded = jnp.any(arm.loads != 0)
        slopes = if_valid(is_loaded, lambda: batch_of(force))
        slopes = eqx.tree_at(lambda x: x.circles, slopes, force.circles)
        return ended, (out, arm, slopes)

    rows = machine.rows(process, motors, row_count)
    index = first + jnp.arange(steps - 1, dtype=jnp.int32)
    is_live = live_rows(1 + index - first, row_count)
    batches = jax.tree.map(_in_batches, PeriodRow(index, rows, is_live))
    is_run = None if is_live is None else batches.is_live[:, 0]
    _, around = scan_rows(batch, started, batches, is_run, together=_TOGETHER)
    out, loaded, forces = jax.tree.map(
        lambda x: jax.lax.collapse(x, 0, 2)[: steps - 1], around
    )

    def slopes(
        _: None, period: LoadedPeriod, is_live: Array | None
    ) -> tuple[None, ArmSlopes]:
        # One after the other: in batches it is no faster, and compiles three times as
        # long.
        return None, arm_slopes(model, period)

    _, arms = scan_rows(slopes, None, loaded, is_live)
    solve = functools.partial(_solved, process, motors.shape[1])
    loads, arm, pose = jax.vmap(solve)(forces, arms)

    def begun(head: Float[Array, "row joint"], parameters: Array) -> Array:
        machine, process = model.scaled(parameters)
        return ravel_pytree(machine.begin(process, head))[0]

    at = motors[:3], model.nominal(motors.dtype)
    head, by_parameters = jax.jacfwd(begun, argnums=(0, 1))(*at)
    head = jnp.concatenate([head.reshape(head.shape[0], -1), by_parameters], axis=1)
    return LinearRun(
        ends=all_ends(out),
        force=prepend_zeros(out.force),
        loads=loads,
        arm=arm,
        pose=pose,
        circles=jnp.maximum(forces.circles - (first - 1), -1),
        begin=head if state is None else jnp.zeros_like(head),
        periods=process.cutter.flute_count,
        substeps=process.engagement.substeps,
    )


def _in_batches(rows: Shaped[Array, " period *any"]) -> Shaped[Array, "..."]:
    """Return rows in batches; the last one is filled up with the last row."""
    index = jnp.arange(-(-rows.shape[0] // _BATCH) * _BATCH)
    return rows[jnp.minimum(index, rows.shape[0] - 1).reshape(-1, _BATCH)]


def prediction(
    engagement: AbstractEngagement,
) -> Float[np.ndarray, "substep substep"]:
    """Weights of the tips of the period so far in the poses that are looked up.

    They are those of the period before, and the way that the tool has moved since or,
    after the first look-up of a period, the way that it is off, extrapolated.
    """
    S, count = engagement.substeps, engagement.substeps // engagement.updates_per_period
    rows, later = np.zeros((S, S)), np.arange(1.0, count + 1)
    for first in range(count, S, count):
        rows[first : first + count, first - 1] = 1 + later
        rows[first : first + count, first - 2] = -later
    return rows


def _solved(
    process: Process, joints: int, force: ForceSlopes, arm: ArmSlopes
) -> tuple[
    Float[Array, "load cause"], Float[Array, "output input"], Float[Array, "pose state"]
]:
    """System of one period with its loads eliminated: `loads`, `arm`, `pose`."""
    engagement, T = process.engagement, process.cutter.flute_count
    S, l, d = force.now.shape
    n, m = arm.end.shape[0], 2 * joints
    dtype = force.now.dtype
    ahead = jnp.asarray(prediction(engagement), dtype)
    is_first = (jnp.arange(S) < S // engagement.updates_per_period).astype(dtype)
    P = arm.pose[:, :n]
    tip = jnp.eye(d, 3, dtype=dtype)
    free = S * l
    inputs = arm.end.shape[1]
    looked = arm.predicted
    if looked is None:
        # r_0 + ahead (tips - r_0) + the motion of the pose.
        looked = jnp.einsum("st,tai->sai", ahead, arm.middles[:, :3])
        looked = looked.at[..., :n].add(is_first[:, None, None] * P[None, :3])
        looked = jnp.concatenate([looked, arm.middles[:, 3:]], axis=1)
    seen = np.eye(S)
    if engagement.samples_whole_period:
        seen = np.tile(seen[-1], (S, 1))
        looked = jnp.broadcast_to(looked[-1:], looked.shape)
    by_arm = jnp.einsum("slp,spi->sli", force.now, arm.middles)
    by_arm = by_arm + jnp.einsum("slp,spi->sli", force.predicted, looked)
    if force.start is not None:
        by_arm = by_arm.at[..., :n].add(jnp.einsum("slp,pi->sli", force.start, P))
    # The remembered poses: (tooth, substep, pose).
    own = jnp.eye(S, dtype=dtype)
    teeth = process.teeth_before(dtype)
    if teeth is None:
        before = jnp.einsum("sltp,su->sltup", force.before, own)
    else:
        before = jnp.einsum("slkjp,skjtu->sltup", force.before, teeth.recent)
        by_newest = jnp.einsum("slp,su->slup", force.newest, own)
        before = before.at[:, :, 0].add(by_newest)
        now = jnp.einsum("slkjp,skju->slup", force.before, teeth.within)
        by_arm = by_arm + jnp.einsum("slup,upi->sli", now, arm.middles)
    last = jnp.zeros_like(force.now)
    if arm.predicted is None:
        by_tip = force.predicted[..., :3]
        before = before.at[:, :, 0, :, :3].add(
            jnp.einsum("sla,su->slua", by_tip, jnp.asarray(seen, dtype) - ahead)
        )
        last = -is_first[:, None, None] * jnp.einsum("sla,pa->slp", by_tip, tip)
    rest = [
        before.reshape(free, T * S * d),
        force.decimated.reshape(free, -1),
        last.reshape(free, d),
    ]
    by_arm = by_arm.reshape(free, inputs)
    by_motion, by_loads, by_parameters = jnp.split(by_arm, [n + m, n + m + free], 1)
    by_parameters = by_parameters + force.parameters.reshape(free, -1)
    stiff = jnp.eye(free, dtype=dtype) - by_loads
    right = jnp.concatenate([by_motion, *rest, by_parameters], axis=1)
    if arm.predicted is None:
        # A load follows those of earlier sub-steps only.
        loads = jax.scipy.linalg.solve_triangular(stiff, right, lower=True)
    else:
        loads = jnp.linalg.solve(stiff, right)
    out = [arm.end, arm.middles.reshape(-1, inputs), arm.ends.reshape(-1, inputs)]
    return loads, jnp.concatenate(out), P
