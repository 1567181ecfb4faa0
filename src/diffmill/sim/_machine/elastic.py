"""The coupled simulation: an elastic robot moves the tool, the cut pushes it back.

The robot's terms (mass matrix, bias forces, Jacobian) are those of the middle of a
period, where half a step predicts the arm: within a period a joint turns by some 1e-4
rad, so they are constant to the square of that, but for the weight, which follows the
joints. Each sub-step (`coupled_period.py`) hands J^T F to the integrator
(`_integrator/base.py`).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from ..._types import Transform
from ...process import Process
from ...robot import ArmTerms, Robot, forward_kinematics
from ...workpiece import Pose
from ._integrator.base import AbstractIntegrator, ArmState, MotorCommand
from ._integrator.midpoint import Midpoint
from .compliant import AbstractInertialMachine, CommandRow, start_rate
from .coupled_period import AbstractPeriodDynamics
from .midpoint_terms import HoldSpan, middle_terms


class ArmPeriod(AbstractPeriodDynamics):
    """The robot in one period, in `work`, ready for its sub-steps.

    Attributes:
        robot: The robot.
        integrator: Rule of its sub-steps.
        pose: At the start.
        joints: At the start [rad or m], shape (joint,).
        jacobian: In the middle, linear rows first; those of the turn only if the
            machine takes a moment.
        prepared: What the integrator has prepared of the terms in the middle.
        motors: Where they are at the start [rad or m], shape (joint,).
        rate: Of the motors [rad/s or m/s], shape (joint,).
        substep: Length of a sub-step [s], shape ().
        torque: Further torque on the joints [N m or N], shape (joint,); None for none.
    """

    robot: Robot
    integrator: AbstractIntegrator
    pose: Pose
    joints: Float[Array, " joint"]
    jacobian: Float[Array, "load joint"]
    prepared: PyTree
    motors: Float[Array, " joint"]
    rate: Float[Array, " joint"]
    substep: Float[Array, ""]
    torque: Float[Array, " joint"] | None = None

    def middle(self, state: ArmState, time: Float[Array, ""]) -> Float[Array, " 3"]:
        """Return the tip in the middle of a sub-step, as fast as at its start [m]."""
        del time
        ahead = state.q + self.substep / 2 * state.v
        return self.pose.tip + self.jacobian[:3] @ (ahead - self.joints)

    def step(
        self, state: ArmState, time: Float[Array, ""], load: Float[Array, " load"]
    ) -> ArmState:
        """Return the state at the end of a sub-step."""
        torque = load @ self.jacobian
        if self.torque is not None:
            torque = torque + self.torque
        command = MotorCommand(self.motors + time * self.rate, self.rate)
        return self.integrator.step(
            self.robot, self.prepared, state, command, torque, self.substep
        )

    def tip(self, state: ArmState) -> Float[Array, " 3"]:
        """Return the tip in a state of the period [m]."""
        return self.pose.tip + self.jacobian[:3] @ (state.q - self.joints)


class ElasticArm(AbstractInertialMachine):
    """A robot with elastic joints; its command are its motors' positions.

    The run starts in equilibrium with gravity, moving with the motors. A command with
    twice as many columns has torques on the joints behind the motors, linear between
    two rows: in them the linear system around a run then has slopes, too.

    Attributes:
        robot: The robot with its tool. Where the process says that the tool stands
            upright, its axis stays along +z of `work`; else it tilts with the robot.
        T_base_work: Pose of the workpiece frame in the robot's base, shape (4, 4).
        integrator: Rule of the robot's sub-steps.
    """

    robot: Robot
    T_base_work: Transform
    integrator: AbstractIntegrator = Midpoint()

    def begin(self, process: Process, command: Float[Array, "step axis"]) -> ArmState:
        """Return the state in equilibrium with the motion at the first instant."""
        command = self.transmitted(command[:3])
        motors, torque = self._split(command[0])
        rate = start_rate(command, process.tooth_period)[: motors.size]
        return ArmState.steady(self.robot, motors, rate, torque)

    def transmitted(
        self, command: Float[Array, "step axis"]
    ) -> Float[Array, "step axis"]:
        """Command behind the gears, without load [rad or m], [N m or N]."""
        if self.robot.gear_waves is None:
            return command
        count = self.robot.joint_count
        motors = jax.vmap(self.robot.transmitted)(command[:, :count])
        return jnp.concatenate([motors, command[:, count:]], axis=1)

    def _split(
        self, command: Float[Array, " axis"]
    ) -> tuple[Float[Array, " joint"], Float[Array, " joint"] | None]:
        """Motors of a row, and torques if it has any."""
        count = self.robot.joint_count
        return command[:count], command[count:] if command.size > count else None

    def pose(self, process: Process, state: ArmState) -> Pose:
        """Return the tool's pose in `work`."""
        T = forward_kinematics(self.robot, state.q)
        return in_work(self.T_base_work, T, process.engagement.is_upright)

    def joint_positions(self, state: ArmState) -> Float[Array, " joint"]:
        """Return the joint positions [rad or m]."""
        return state.q

    @property
    def load_count(self) -> int:
        """Numbers of a load: on a bending tool the height counts at which it acts."""
        return 6 if self.robot.fast_joints else 3

    def dynamics(self, process: Process, state: ArmState, row: CommandRow) -> ArmPeriod:
        """Return the robot in a period, from its state and the motors."""
        robot, rule = self.robot, self.integrator
        start, torque = self._split(row.start)
        stop, later = self._split(row.stop)
        if torque is not None and later is not None:
            torque = (torque + later) / 2
        rate = (stop - start) / process.tooth_period
        held = HoldSpan(process.tooth_period, process.engagement.substeps)
        terms = ArmTerms.of_state(robot, state.q, state.v)
        T_base_work, is_upright = self.T_base_work, process.engagement.is_upright
        pose = in_work(T_base_work, terms.T_base_tool, is_upright)
        motors = MotorCommand(start, rate)
        terms = middle_terms(robot, rule, terms, state, motors, held)
        return ArmPeriod(
            robot=robot,
            integrator=rule,
            pose=pose,
            joints=state.q,
            jacobian=jacobian_in_work(T_base_work, terms.jacobian)[: self.load_count],
            prepared=rule.begin(robot, terms, held.substep),
            motors=start,
            rate=rate,
            substep=held.substep,
            torque=torque,
        )


def in_work(
    T_base_work: Transform, T_base_tool: Float[Array, "4 4"], is_upright: bool
) -> Pose:
    """Return the tool's pose in `work`; without an axis if it is upright."""
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
