"""The coupled simulation: an elastic robot moves the tool, the cut pushes it back.

One `lax.scan` over tooth periods. The robot's terms (mass matrix, bias forces,
Jacobian) are those of the middle of a period, where half a step predicts the arm:
within a period a joint turns by some 1e-4 rad, so they are constant to the square of
that, but for the weight, which follows the joints. Each sub-step then takes
the force F of the teeth that pass in it, at the tip where the robot will be in the
middle of the sub-step, and hands J^T F to the integrator (`_integrator/base.py`).
"""

from typing import Any, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..._result import RESULTS
from ..._types import IntScalar, RealScalarLike, Transform
from ...cutter import AbstractCutter
from ...cutting import AbstractForceLaw
from ...numerics import sloped
from ...process import (
    AbstractAdjoint,
    BottomEngagement,
    EdgeSamples,
    Engagement,
    ProcessPlan,
    ProcessState,
    Removed,
    Substeps,
    advance_process,
    advance_removal,
    compute_engagement,
    end_period,
    failed_rows,
    initial_state,
    last_row,
    live_rows,
    outcome,
    remove_all,
    substep_middles,
    substep_wrench,
    volumes_by_pose,
    when_live,
)
from ...robot import Robot, arm_terms, forward_kinematics
from ...workpiece import Pose, Stock
from ._integrator.base import AbstractIntegrator, ArmState, MotorCommand, steady_state
from ._integrator.midpoint import Midpoint
from .midpoint_terms import middle_terms

# The side edges of one sub-step, and its bottom edges.
_Edges: TypeAlias = tuple[EdgeSamples, BottomEngagement | None]
# What evolves: the process and the arm.
Carry: TypeAlias = tuple[ProcessState, ArmState]


class CoupledSolution(eqx.Module):
    """Solution of a robot that cuts.

    Attributes:
        actual: Tool tip in `work` at the tooth instants [m], shape (step, 3).
        ends: Tool tip at the ends of the sub-steps of the period before each instant
            [m], shape (step, substep, 3); row 0 is at rest.
        force: Mean force on the tool over the period before each instant, in `work`
            [N], shape (step, 3); zero in row 0.
        joint_positions: [rad or m], shape (step, joint).
        removed_volume: Volume that each pose removes [m^3], shape (step,).
        shank_volume: What of it the shank takes [m^3], shape (step,).
        initial_overlap_volume: Stock inside the tool at the first pose [m^3].
        stock: The stock after the last pose.
        has_failed: Whether a flag was up after each step, shape (step,).
        result: Outcome of the run.
    """

    actual: Float[Array, "step 3"]
    ends: Float[Array, "step substep 3"]
    force: Float[Array, "step 3"]
    joint_positions: Float[Array, "step joint"]
    removed_volume: Float[Array, " step"]
    shank_volume: Float[Array, " step"]
    initial_overlap_volume: Float[Array, ""]
    stock: Stock
    has_failed: Bool[Array, " step"]
    result: RESULTS


class _Arm(eqx.Module):
    """The robot's terms of one period, in `work`, ready for its sub-steps.

    Attributes:
        pose: At the start.
        jacobian: In the middle, linear rows first.
        begun: What the integrator has prepared of the terms in the middle.
    """

    pose: Pose
    jacobian: Float[Array, "6 joint"]
    begun: Any


class Period(eqx.Module):
    """Outputs of one tooth period."""

    tip: Float[Array, " 3"]
    ends: Float[Array, "substep 3"]
    force: Float[Array, " 3"]
    joint_positions: Float[Array, " joint"]
    removed: Removed
    has_failed: Bool[Array, ""]


class Machine(eqx.Module):
    """Constants of a run.

    Attributes:
        robot: The robot with its tool.
        T_base_work: Pose of the workpiece frame in the robot's base, shape (4, 4).
        cutter: The milling cutter.
        laws: Force law of the teeth, and of the bottom edges or None.
        tooth_period: Time between two teeth [s], shape ().
        plan: Sizes of the process.
        adjoint: How to differentiate through the removal.
        integrator: Rule of the robot's sub-steps.
    """

    robot: Robot
    T_base_work: Float[Array, "4 4"]
    cutter: AbstractCutter
    laws: tuple[AbstractForceLaw, AbstractForceLaw | None]
    tooth_period: Float[Array, ""]
    plan: ProcessPlan
    adjoint: AbstractAdjoint
    integrator: AbstractIntegrator

    @property
    def substep(self) -> Float[Array, ""]:
        """Length of a sub-step [s]."""
        return self.tooth_period / self.plan.substeps


def simulate_coupled(
    motor_positions: Float[Array, "step joint"],
    robot: Robot,
    T_base_work: Transform,
    stock: Stock,
    cutter: AbstractCutter,
    law: AbstractForceLaw,
    tooth_period: RealScalarLike,
    plan: ProcessPlan,
    adjoint: AbstractAdjoint,
    bottom_law: AbstractForceLaw | None = None,
    integrator: AbstractIntegrator | None = None,
    row_count: IntScalar | None = None,
) -> CoupledSolution:
    """Move the motors, let the arm follow and cut.

    The run starts in equilibrium with gravity, moving with the motors.

    Args:
        motor_positions: Motor angles theta at the tooth instants, behind the gear on
            the joint's side [rad or m], shape (step, joint); 0 for virtual joints.
        robot: The robot with its tool.
        T_base_work: Pose of the workpiece in the robot's base, shape (4, 4).
        stock: The raw workpiece.
        cutter: The cutter. Where the plan says that it stands upright, its axis
            stays along +z of `work`; else it tilts with the robot.
        law: The force law.
        tooth_period: T [s], shape ().
        plan: Sizes of the process.
        adjoint: How to differentiate through the removal.
        bottom_law: The law of the bottom edge; derived from `law` if not given.
        integrator: The rule of the robot's sub-steps; `Midpoint()` if not given.
        row_count: How many rows count, those behind leave everything as it is; shape
            (). All rows if not given.

    Returns:
        The motion, the forces and the final stock.

    Differentiability: as `simulate_process`; also in the robot's leaves.
    """
    theta = motor_positions
    step_count = theta.shape[0]
    machine = coupled_machine(
        robot,
        T_base_work,
        cutter,
        law,
        tooth_period,
        plan,
        adjoint,
        bottom_law,
        integrator,
        theta.dtype,
    )
    carry, overlap = begin(machine, stock, theta, step_count)
    first = jnp.ones((), jnp.int32)
    carry, rows = run_periods(machine, carry, theta, first, row_count)
    return _finish(machine, carry, rows, overlap, last_row(step_count, row_count))


def coupled_machine(
    robot: Robot,
    T_base_work: Transform,
    cutter: AbstractCutter,
    law: AbstractForceLaw,
    tooth_period: RealScalarLike,
    plan: ProcessPlan,
    adjoint: AbstractAdjoint,
    bottom_law: AbstractForceLaw | None,
    integrator: AbstractIntegrator | None,
    dtype: jnp.dtype,
) -> Machine:
    """Return the arguments of `simulate_coupled` as one tree, in one precision.

    **Differentiability**: linear, the arguments are kept as they are.
    """
    frame, period = jnp.asarray(T_base_work, dtype), jnp.asarray(tooth_period, dtype)
    rule = Midpoint() if integrator is None else integrator
    laws = (law, bottom_law)
    return Machine(robot, frame, cutter, laws, period, plan, adjoint, rule)


def begin(
    machine: Machine,
    stock: Stock,
    theta: Float[Array, "step joint"],
    pose_count: int,
) -> tuple[Carry, Float[Array, ""]]:
    """Return the state in equilibrium with the motion at the first instant.

    Args:
        machine: What stays the same.
        stock: The raw workpiece.
        theta: Motors at the first instants [rad or m], shape (step, joint), of which
            three count.
        pose_count: Rows of the table of poses.

    Returns:
        The state, and the volume of the stock inside the tool [m^3].
    """
    rate = _start_rate(theta, machine.tooth_period)
    state = steady_state(machine.robot, theta[0], rate)
    first = pose_at(machine, state)
    process, overlap = initial_state(
        machine.plan, stock, machine.cutter, first, pose_count, machine.adjoint
    )
    return (process, state), overlap


def _start_rate(
    theta: Float[Array, "step joint"], period: Float[Array, ""]
) -> Float[Array, " joint"]:
    """Return how fast the motors move at the first instant.

    By the parabola through three instants: the mean speed of the first period alone
    would let an arm that starts from rest begin in motion.
    """
    rise = theta[1] - theta[0]
    if theta.shape[0] > 2:
        rise = rise - (theta[2] - 2 * theta[1] + theta[0]) / 2
    return rise / period


def run_periods(
    machine: Machine,
    carry: Carry,
    theta: Float[Array, "step joint"],
    index: Int[Array, ""],
    row_count: IntScalar | None = None,
) -> tuple[Carry, Period]:
    """Return the state after all periods between some rows, and their rows.

    Args:
        machine: What stays the same.
        carry: State at the first row.
        theta: Motors at the rows [rad or m], shape (step, joint).
        index: Index of the first period: the row in the table of poses of its end.
        row_count: Periods of this index and above leave everything as it is; None for
            no such.

    Returns:
        The state at the last row; a row per period, for its start.
    """

    def step(
        carry: Carry, x: tuple[Array, Array, Array, Array | None]
    ) -> tuple[Carry, Period]:
        return run_period(machine, *carry, *x)

    indices = index + jnp.arange(theta.shape[0] - 1, dtype=jnp.int32)
    xs = (indices, theta[:-1], theta[1:], live_rows(indices, row_count))
    return jax.lax.scan(step, carry, xs)


def _finish(
    machine: Machine,
    carry: Carry,
    rows: Period,
    overlap: Float[Array, ""],
    last: Int[Array, ""],
) -> CoupledSolution:
    """Remove what is pending, and put the rows of all poses together."""
    process, state = carry
    plan, cutter, adjoint = machine.plan, machine.cutter, machine.adjoint
    dtype, step_count = rows.tip.dtype, rows.tip.shape[0] + 1
    final = pose_at(machine, state)
    process, rest = remove_all(plan, cutter, process, last, final, step_count, adjoint)
    actual = through(rows.tip, final.tip, last)
    volume, by_shank = volumes_by_pose(step_count, rows.removed, rest)
    return CoupledSolution(
        actual=actual,
        ends=all_ends(rows.tip[0], rows.ends),
        force=jnp.concatenate([jnp.zeros((1, 3), dtype), rows.force]),
        joint_positions=through(rows.joint_positions, state.q, last),
        removed_volume=volume,
        shank_volume=by_shank,
        initial_overlap_volume=overlap,
        stock=process.stock,
        has_failed=failed_rows(rows.has_failed, process, last),
        result=outcome(process, jnp.all(jnp.isfinite(actual))),
    )


def through(
    rows: Float[Array, "period n"], final: Float[Array, " n"], last: Int[Array, ""]
) -> Float[Array, "step n"]:
    """Return the rows at the start of every period, and from the last one on the end.

    Args:
        rows: One per period, shape (period, n).
        final: What is reached in the end, shape (n,).
        last: Index of the last row that counts, shape ().
    """
    rows = jnp.concatenate([rows, final[None]])
    index = jnp.arange(rows.shape[0], dtype=jnp.int32)
    return jnp.where((index < last)[:, None], rows, final[None])


def all_ends(
    start: Float[Array, " 3"], ends: Float[Array, "period substep 3"]
) -> Float[Array, "step substep 3"]:
    """Return the ends of sub-steps with those before the first instant, at rest."""
    rest = jnp.broadcast_to(start[None, None], (1, *ends.shape[1:]))
    return jnp.concatenate([rest, ends])


def along(pose: Pose, tips: Float[Array, "substep 3"]) -> Pose:
    """Return poses at other tips: within a period the tool does not tilt."""
    if pose.axis is None:
        return Pose(tips)
    return Pose(tips, jnp.broadcast_to(pose.axis[None], tips.shape))


def pose_at(machine: Machine, state: ArmState) -> Pose:
    """Return the tool's pose in `work`."""
    return _in_work(machine, forward_kinematics(machine.robot, state.q))


def _in_work(machine: Machine, T_base_tool: Float[Array, "4 4"]) -> Pose:
    T_base_work = machine.T_base_work
    to_work = T_base_work[:3, :3].T
    tip = to_work @ (T_base_tool[:3, 3] - T_base_work[:3, 3])
    return Pose(tip, None if machine.plan.is_upright else to_work @ T_base_tool[:3, 2])


def _arm_in(machine: Machine, state: ArmState, motors: MotorCommand) -> _Arm:
    """Return the robot's terms in a period, from state and motors at its start."""
    robot = machine.robot
    terms = arm_terms(robot, state.q, state.v)
    pose = _in_work(machine, terms.T_base_tool)
    rule, substeps = machine.integrator, machine.plan.substeps
    T = machine.tooth_period
    terms = middle_terms(robot, rule, terms, state, motors, T, substeps)
    return _Arm(
        pose=pose,
        jacobian=in_work(machine.T_base_work, terms.jacobian),
        begun=rule.begin(robot, terms, machine.substep),
    )


def run_period(
    machine: Machine,
    process: ProcessState,
    state: ArmState,
    index: Int[Array, ""],
    start: Float[Array, " joint"],
    stop: Float[Array, " joint"],
    is_live: Bool[Array, ""] | None = None,
) -> tuple[tuple[ProcessState, ArmState], Period]:
    """Return the state after one tooth period, and its row.

    Args:
        machine: What stays the same.
        process: The process at the start.
        state: The arm at the start.
        index: Index of the period, from 1, shape ().
        start: Motors at the start [rad or m], shape (joint,).
        stop: Motors at the end, shape (joint,).
        is_live: Whether the period counts; None if all do. Else the arm stands still.
    """
    T = machine.tooth_period
    middles = substep_middles(machine.plan, start.dtype)
    rate = (stop - start) / T
    arm = _arm_in(machine, state, MotorCommand(start, rate))
    # As in the period before: what the teeth do comes again, and drifts are slow.
    drift = (arm.pose.tip - process.last_tip)[None]
    predicted = along(arm.pose, process.recent.tip[0] + drift)
    plan, cutter, adjoint = machine.plan, machine.cutter, machine.adjoint
    cut = None
    if plan.looks > 1:
        process, removed = advance_removal(
            plan, cutter, process, index - 1, arm.pose, adjoint
        )
    else:
        process, cut, removed = advance_process(
            plan, cutter, process, index, arm.pose, predicted, adjoint, is_live
        )
    targets = start[None] + T * middles[:, None] * rate[None]
    rest = jnp.broadcast_to(arm.pose.tip[None], predicted.tip.shape)
    end, (tips, ends, forces) = when_live(
        is_live,
        lambda: (
            _run_looks(machine, arm, process, index, state, targets, rate, drift)
            if cut is None
            else _run_substeps(
                machine, arm, process, cut, state, targets, rate, state.q
            )
        ),
        (state, (predicted.tip, rest, jnp.zeros_like(rest))),
    )
    process = end_period(process, along(arm.pose, tips), along(arm.pose, ends))
    has_failed = process.has_overflow | process.is_beyond
    force = jnp.mean(forces, axis=0)
    return (process, end), Period(
        arm.pose.tip, ends, force, state.q, removed, has_failed
    )


def _run_looks(
    machine: Machine,
    arm: _Arm,
    process: ProcessState,
    index: Int[Array, ""],
    start: ArmState,
    targets: Float[Array, "substep joint"],
    rate: Float[Array, " joint"],
    drift: Float[Array, "1 3"],
) -> tuple[ArmState, tuple[Float[Array, "substep 3"], ...]]:
    """Return what `_run_substeps` does, the stock looked up several times on the way.

    Where a period is long, an arm swings within it, and the period before does not tell
    where the tool will be in its later sub-steps.
    """
    looks = machine.plan.looks
    count = machine.plan.substeps // looks

    def part(
        carry: tuple[ArmState, Array], x: tuple[Array, Array, Pose]
    ) -> tuple[tuple[ArmState, Array], tuple[Array, ...]]:
        state, ahead = carry
        first, targets, recent = x
        near = eqx.tree_at(lambda p: p.recent, process, recent)
        predicted = along(arm.pose, recent.tip[0] + ahead)
        cut = compute_engagement(
            machine.plan,
            machine.cutter,
            near,
            index,
            predicted,
            machine.adjoint,
            Substeps(first, count),
        )
        end, rows = _run_substeps(
            machine, arm, near, cut, state, targets, rate, start.q
        )
        # How far the tool is off the period before goes on changing as it did.
        off = rows[0] - recent.tip[0]
        later = jnp.arange(1, count + 1, dtype=off.dtype)[:, None]
        return (end, off[-1:] + later * (off[-1:] - off[-2:-1])), rows

    split = lambda x: x.reshape(looks, count, *x.shape[1:])
    recent = jax.tree.map(
        lambda x: jnp.swapaxes(jax.vmap(split)(x), 0, 1), process.recent
    )
    first = count * jnp.arange(looks, dtype=jnp.int32)
    ahead = jnp.broadcast_to(drift, (count, 3))
    (end, _), rows = jax.lax.scan(part, (start, ahead), (first, split(targets), recent))
    return end, tuple(x.reshape(-1, x.shape[-1]) for x in rows)


def _run_substeps(
    machine: Machine,
    arm: _Arm,
    process: ProcessState,
    cut: Engagement,
    start: ArmState,
    targets: Float[Array, "substep joint"],
    rate: Float[Array, " joint"],
    origin: Float[Array, " joint"],
) -> tuple[ArmState, tuple[Float[Array, "substep 3"], ...]]:
    """Return the state after sub-steps of a period, and these.

    Of these the tips in their middle, those at their ends, and the forces.
    """
    robot, h = machine.robot, machine.substep
    keeps_slopes = machine.adjoint.keeps_slopes
    # Only on a bending tool the height at which a force acts counts for anything.
    mean_load = _mean_wrench if robot.fast_joints else _mean_force
    mean_load = sloped(mean_load) if keeps_slopes else mean_load
    J = arm.jacobian[:3]

    def substep(
        state: ArmState, x: tuple[Array, Pose, _Edges]
    ) -> tuple[ArmState, tuple[Array, Array, Array]]:
        theta, earlier, edges = x
        tip = arm.pose.tip + J @ (state.q + h / 2 * state.v - origin)
        pose = Pose(tip, arm.pose.axis)
        tool = (machine.plan, machine.cutter, *machine.laws)
        F = mean_load(*tool, pose, earlier, cut.thinned, *edges)
        load = arm.jacobian[: F.size].T @ F
        command = MotorCommand(theta, rate)
        end = machine.integrator.step(robot, arm.begun, state, command, load, h)
        return end, (tip, arm.pose.tip + J @ (end.q - origin), F[:3])

    earlier = jax.tree.map(lambda x: jnp.moveaxis(x, 0, 1), process.recent)
    xs = (targets, earlier, (cut.samples, cut.bottom))
    # Without slopes, what the forces come from is computed again rather than kept.
    step = substep if keeps_slopes else jax.checkpoint(substep)
    return jax.lax.scan(step, start, xs)


def _mean_force(*args: Any) -> Float[Array, " 3"]:
    """Return the force of a sub-step; arguments of `substep_wrench`."""
    return _mean_wrench(*args)[:3]


def _mean_wrench(*args: Any) -> Float[Array, " 6"]:
    """Return force and moment of a sub-step; arguments of `substep_wrench`."""
    return jnp.mean(substep_wrench(*args), axis=0)


def in_work(
    T_base_work: Float[Array, "4 4"], jacobian: Float[Array, "6 joint"]
) -> Float[Array, "6 joint"]:
    """Return a Jacobian with both halves in the axes of the work."""
    to_work = T_base_work[:3, :3].T
    return jnp.concatenate([to_work @ jacobian[:3], to_work @ jacobian[3:]])
