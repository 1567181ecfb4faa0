"""The coupled simulation: an elastic robot moves the tool, the cut pushes it back.

The robot's terms (mass matrix, bias forces, Jacobian) are those of the middle of a
period, where half a step predicts the arm: within a period a joint turns by some 1e-4
rad, so they are constant to the square of that, but for the weight, which follows the
joints. Each sub-step then takes the force F of the teeth that pass in it, at the tip
where the robot will be in the middle of the sub-step, and hands J^T F to the integrator
(`_integrator/base.py`).
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..._types import IntScalar, Transform
from ...process import (
    EdgeSamples,
    Engagement,
    Process,
    Substeps,
    advance_process,
    substep_middles,
    when_live,
)
from ...robot import Robot, arm_terms, forward_kinematics
from ...workpiece import Pose
from ._integrator.base import AbstractIntegrator, ArmState, MotorCommand, steady_state
from ._integrator.midpoint import Midpoint
from .machine import AbstractMachine, Period, RunState
from .midpoint_terms import HeldSpan, middle_terms


class MotorRow(eqx.Module):
    """Motors in one tooth period, or in all.

    Attributes:
        start: theta at its start [rad or m], shape (*period, joint).
        stop: theta at its end, same shape.
    """

    start: Float[Array, "*period joint"]
    stop: Float[Array, "*period joint"]


class Arm(eqx.Module):
    """The robot in one period, in `work`, ready for its sub-steps.

    Attributes:
        pose: At the start.
        joints: At the start [rad or m], shape (joint,).
        jacobian: In the middle, linear rows first.
        begun: What the integrator has prepared of the terms in the middle.
        rate: Of the motors [rad/s or m/s], shape (joint,).
        substep: Length of a sub-step [s], shape ().
    """

    pose: Pose
    joints: Float[Array, " joint"]
    jacobian: Float[Array, "6 joint"]
    begun: Any
    rate: Float[Array, " joint"]
    substep: Float[Array, ""]


class ArmSubsteps(eqx.Module):
    """Sub-steps of a period.

    Attributes:
        predicted: Tips at which the stock was looked up [m], shape (*substep, 3).
        tips: Tips in their middle [m], same shape.
        ends: Tips at their ends [m], same shape.
        loads: Forces in `work` [N] and, on a bending tool, their moments about the tip
            [N m], shape (*substep, load).
    """

    predicted: Float[Array, "*substep 3"]
    tips: Float[Array, "*substep 3"]
    ends: Float[Array, "*substep 3"]
    loads: Float[Array, "*substep load"]


class _Look(eqx.Module):
    """A look at the stock: the poses that were expected, and what was found there."""

    predicted: Pose
    found: Engagement


class ElasticArm(AbstractMachine):
    """A robot with elastic joints; its command are its motors' positions.

    The run starts in equilibrium with gravity, moving with the motors.

    Attributes:
        robot: The robot with its tool. Where the process says that the tool stands
            upright, its axis stays along +z of `work`; else it tilts with the robot.
        T_base_work: Pose of the workpiece frame in the robot's base, shape (4, 4).
        integrator: Rule of the robot's sub-steps.
    """

    robot: Robot
    T_base_work: Transform
    integrator: AbstractIntegrator = Midpoint()

    def begin(self, process: Process, command: Float[Array, "step joint"]) -> ArmState:
        """Return the state in equilibrium with the motion at the first instant."""
        rate = start_rate(command, process.tooth_period)
        return steady_state(self.robot, command[0], rate)

    def rows(
        self,
        process: Process,
        command: Float[Array, "step joint"],
        row_count: IntScalar | None,
    ) -> MotorRow:
        """Return the motors at both ends of every period."""
        del process, row_count
        return MotorRow(command[:-1], command[1:])

    def pose(self, process: Process, state: ArmState) -> Pose:
        """Return the tool's pose in `work`."""
        T = forward_kinematics(self.robot, state.q)
        return in_work(self.T_base_work, T, process.engagement.is_upright)

    def joint_positions(self, state: ArmState) -> Float[Array, " joint"]:
        """Return the joint positions [rad or m]."""
        return state.q

    def period(
        self,
        process: Process,
        state: RunState,
        index: Int[Array, ""],
        row: MotorRow,
        is_live: Bool[Array, ""] | None,
    ) -> tuple[RunState, Period]:
        """Return the state after one tooth period, and its outputs."""
        return self.follow(process, state, index, row, is_live)[:2]

    def follow(
        self,
        process: Process,
        state: RunState,
        index: Int[Array, ""],
        row: MotorRow,
        is_live: Bool[Array, ""] | None = None,
    ) -> tuple[RunState, Period, ArmSubsteps]:
        """Return what `period` does, and the sub-steps."""
        cutting, start = state.process, state.machine
        engagement, T = process.engagement, process.tooth_period
        rate = (row.stop - row.start) / T
        arm = self.arm(process, start, MotorCommand(row.start, rate))
        # As in the period before: what the teeth do comes again, and drifts are slow.
        drift = (arm.pose.tip - cutting.last_tip)[None]
        predicted = along(arm.pose, cutting.recent.tip[0] + drift)
        middles = substep_middles(engagement.substeps, row.start.dtype)
        targets = row.start[None] + T * middles[:, None] * rate[None]
        if engagement.looks > 1:
            cutting, removed = engagement.advance(process, cutting, index - 1, arm.pose)
            advanced = RunState(cutting, start, state.period_count)
            follow = lambda: self._run_looks(
                process, arm, advanced, index, targets, drift
            )
        else:
            cutting, cut, removed = advance_process(
                process, cutting, index, arm.pose, predicted, is_live
            )
            follow = lambda: self._run_substeps(
                process, arm, cutting.recent, _Look(predicted, cut), start, targets
            )
        rest = jnp.broadcast_to(arm.pose.tip[None], predicted.tip.shape)
        none = jnp.zeros((rest.shape[0], self.load_count), rest.dtype)
        still = ArmSubsteps(predicted.tip, predicted.tip, rest, none)
        end, steps = when_live(is_live, follow, (start, still))
        cutting = cutting.ended(
            along(arm.pose, steps.tips), along(arm.pose, steps.ends)
        )
        period = Period(
            tip=arm.pose.tip,
            ends=steps.ends,
            force=jnp.mean(steps.loads[:, :3], axis=0),
            joint_positions=start.q,
            removed=removed,
            has_failed=cutting.has_overflow | cutting.is_beyond,
        )
        return RunState(cutting, end, state.period_count), period, steps

    @property
    def load_count(self) -> int:
        """Numbers of a load: on a bending tool the height counts at which it acts."""
        return 6 if self.robot.fast_joints else 3

    def arm(self, process: Process, state: ArmState, motors: MotorCommand) -> Arm:
        """Return the robot in a period, from state and motors at its start."""
        robot, rule = self.robot, self.integrator
        span = HeldSpan(process.tooth_period, process.engagement.substeps)
        terms = arm_terms(robot, state.q, state.v)
        T_base_work, is_upright = self.T_base_work, process.engagement.is_upright
        pose = in_work(T_base_work, terms.T_base_tool, is_upright)
        terms = middle_terms(robot, rule, terms, state, motors, span)
        return Arm(
            pose=pose,
            joints=state.q,
            jacobian=jacobian_in_work(T_base_work, terms.jacobian),
            begun=rule.begin(robot, terms, span.substep),
            rate=motors.rate,
            substep=span.substep,
        )

    def _run_looks(
        self,
        process: Process,
        arm: Arm,
        begun: RunState,
        index: Int[Array, ""],
        targets: Float[Array, "substep joint"],
        drift: Float[Array, "1 3"],
    ) -> tuple[ArmState, ArmSubsteps]:
        """Return what `_run_substeps` does, the stock looked up several times.

        Where a period is long, an arm swings within it, and the period before does not
        tell where the tool will be in its later sub-steps.
        """
        engagement, cutting = process.engagement, begun.process
        looks = engagement.looks
        count = engagement.substeps // looks

        def part(
            carry: tuple[ArmState, Array], x: tuple[Array, Array, Pose]
        ) -> tuple[tuple[ArmState, Array], ArmSubsteps]:
            state, ahead = carry
            first, targets, recent = x
            near = eqx.tree_at(lambda p: p.recent, cutting, recent)
            predicted = along(arm.pose, recent.tip[0] + ahead)
            substeps = Substeps(first, count)
            cut = engagement.engage(process, near, index, predicted, substeps)
            look = _Look(predicted, cut)
            end, rows = self._run_substeps(process, arm, recent, look, state, targets)
            # How far the tool is off the period before goes on changing as it did.
            off = rows.tips - recent.tip[0]
            later = jnp.arange(1, count + 1, dtype=off.dtype)[:, None]
            return (end, off[-1:] + later * (off[-1:] - off[-2:-1])), rows

        split = lambda x: x.reshape(looks, count, *x.shape[1:])
        recent = jax.tree.map(
            lambda x: jnp.swapaxes(jax.vmap(split)(x), 0, 1), cutting.recent
        )
        first = count * jnp.arange(looks, dtype=jnp.int32)
        ahead = jnp.broadcast_to(drift, (count, 3))
        xs = (first, split(targets), recent)
        (end, _), rows = jax.lax.scan(part, (begun.machine, ahead), xs)
        return end, jax.tree.map(lambda x: x.reshape(-1, x.shape[-1]), rows)

    def _run_substeps(
        self,
        process: Process,
        arm: Arm,
        recent: Pose,
        look: _Look,
        start: ArmState,
        targets: Float[Array, "substep joint"],
    ) -> tuple[ArmState, ArmSubsteps]:
        """Return the state after sub-steps of a period, and these."""
        robot, h = self.robot, arm.substep
        mean_load = _mean_wrench if self.load_count == 6 else _mean_force
        J = arm.jacobian[:3]
        tool = _tool_of(process)

        def substep(
            state: ArmState, x: tuple[Array, Array, Pose, EdgeSamples]
        ) -> tuple[ArmState, ArmSubsteps]:
            theta, looked, earlier, samples = x
            tip = arm.pose.tip + J @ (state.q + h / 2 * state.v - arm.joints)
            pose = Pose(tip, arm.pose.axis)
            F = mean_load(tool, samples, pose, earlier, look.found.thinned)
            load = arm.jacobian[: F.size].T @ F
            command = MotorCommand(theta, arm.rate)
            end = self.integrator.step(robot, arm.begun, state, command, load, h)
            moved = arm.pose.tip + J @ (end.q - arm.joints)
            return end, ArmSubsteps(looked, tip, moved, F)

        earlier = jax.tree.map(lambda x: jnp.moveaxis(x, 0, 1), recent)
        # What the forces come from is computed again rather than kept.
        xs = (targets, look.predicted.tip, earlier, look.found.samples)
        return jax.lax.scan(jax.checkpoint(substep), start, xs)


def _tool_of(process: Process) -> Process:
    """Return a process without its stock, of which a force knows nothing."""
    return eqx.tree_at(lambda p: p.stock, process, None)


def _mean_force(
    process: Process, samples: EdgeSamples, pose: Pose, earlier: Pose, thinned: Pose
) -> Float[Array, " 3"]:
    """Return the force of a sub-step."""
    return _mean_wrench(process, samples, pose, earlier, thinned)[:3]


def _mean_wrench(
    process: Process, samples: EdgeSamples, pose: Pose, earlier: Pose, thinned: Pose
) -> Float[Array, " 6"]:
    """Return force and moment of a sub-step."""
    found = process.engagement.wrench(process, samples, pose, earlier, thinned)
    return jnp.mean(found, axis=0)


def start_rate(
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


def along(pose: Pose, tips: Float[Array, "substep 3"]) -> Pose:
    """Return poses at other tips: within a period the tool does not tilt."""
    if pose.axis is None:
        return Pose(tips)
    return Pose(tips, jnp.broadcast_to(pose.axis[None], tips.shape))


def in_work(
    T_base_work: Transform, T_base_tool: Float[Array, "4 4"], is_upright: bool
) -> Pose:
    """Return the tool's pose in `work`; without an axis if it stands upright."""
    frame = jnp.asarray(T_base_work, T_base_tool.dtype)
    to_work = frame[:3, :3].T
    tip = to_work @ (T_base_tool[:3, 3] - frame[:3, 3])
    return Pose(tip, None if is_upright else to_work @ T_base_tool[:3, 2])


def jacobian_in_work(
    T_base_work: Transform, jacobian: Float[Array, "6 joint"]
) -> Float[Array, "6 joint"]:
    """Return a Jacobian with both halves in the axes of the work."""
    to_work = jnp.asarray(T_base_work, jacobian.dtype)[:3, :3].T
    return jnp.concatenate([to_work @ jacobian[:3], to_work @ jacobian[3:]])
