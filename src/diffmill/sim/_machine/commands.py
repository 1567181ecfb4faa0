"""From the tips that a program commands to the motors of the job's robot.

Inverse kinematics takes long to compile. On the host it runs by programs of its own, of
few lengths, which all that need joints or motors share.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..._arrays import first_rows, is_traced, on_device
from ..._job import Job
from ..._padding import in_pieces, live_rows, map_rows, pad_rows, padded_count
from ..._types import FloatRows3, Transform
from ...numerics import CachedJit
from ...robot import (
    JointSolution,
    Robot,
    ToolRotation,
    inverse_kinematics,
    inverse_kinematics_path,
    motor_positions,
    placed_motors,
)
from ...workpiece import Pose


class JointRows(NamedTuple):
    """Positions of joints, or of their motors, that a command asks for.

    Attributes:
        positions: [rad or m], shape (step, joint).
        is_reached: Whether each tip is reached, shape (step,).
    """

    positions: Float[Array, "step joint"]
    is_reached: Bool[Array, " step"]


class JobKinematics(eqx.Module):
    """Kinematics of the machine of a job, from commanded tips to its motors.

    A machine of modes has no joints: its drives are where the tip is.

    Attributes:
        arm: The robot that the controller knows; None for a machine of modes.
        T_base_work: Pose of the workpiece frame in the robot's base, shape (4, 4).
        joint_start: Joints near which inverse kinematics begins, shape (joint,); None
            for the robot's home.
        tool_axes: Tool axes of the path, shape (step, 3); None if it is upright.
        tool_x: Unit x of the tool, shape (step, 3); None if the path leaves it open.
        tool_rotation: Rotation about the tool axis, as of the job.
        is_gravity_compensated: Whether the controller takes the sag away.
        motor_places: `NominalRobot.motor_places`, where the machine is not the one that
            the controller knows; None where it is.
    """

    arm: Robot | None
    T_base_work: Transform
    joint_start: Float[Array, " joint"] | Float[np.ndarray, " joint"] | None
    tool_axes: Float[Array, "step 3"] | None
    tool_x: FloatRows3 | None
    tool_rotation: ToolRotation = eqx.field(static=True)
    is_gravity_compensated: bool = eqx.field(static=True)
    motor_places: tuple[int, ...] | None = eqx.field(static=True)

    def __init__(self, job: Job):
        """Take what the kinematics needs of a job in its precision.

        Raises:
            ValueError: The machine is rigid.
        """
        if job.is_rigid:
            raise ValueError(
                "Argument `job` must have a robot, but its machine is rigid."
            )
        known = job.as_known
        self.arm = known.robot
        self.T_base_work = known.T_base_work
        self.motor_places = None
        if job.nominal is not None and job.robot is not None:
            self.motor_places = job.nominal.motor_places(job.robot)
        self.joint_start = job.joint_start
        self.tool_axes = job.tool_axes
        self.tool_x = job.path.tool_x
        self.tool_rotation = job.tool_rotation
        self.is_gravity_compensated = job.simulation.is_gravity_compensated

    @property
    def robot(self) -> Robot:
        """The robot.

        Raises:
            ValueError: The machine is given by its modes.
        """
        if self.arm is None:
            raise ValueError("Argument `job` must have a robot, but has modes.")
        return self.arm

    def solve(self, commanded: Float[Array, "step 3"]) -> JointSolution:
        """Solution of inverse kinematics for tip positions, as `joints`."""
        robot = self.robot
        axes, tool_x = self.tool_axes, self.tool_x
        start = (
            robot.home if self.joint_start is None else jnp.asarray(self.joint_start)
        )
        frame, rows = jnp.asarray(self.T_base_work), (commanded, axes, tool_x)
        if is_traced((self, commanded)):
            Ts = _poses(frame, *rows)
        else:
            Ts = in_pieces(lambda rows: _poses(frame, *rows), rows)
        return inverse_kinematics_path(
            robot,
            Ts,
            start,
            tool_rotation=self.tool_rotation,
        )

    def joints(self, commanded: Float[Array, "step 3"]) -> "JointRows":
        """Return the joint positions of tip positions, and which of them are reached.

        The tool axis is the path's. Tool x is the path's too; where that states none,
        it is as near to x of `work` as the axis allows, or as it suits the joints if
        the job leaves the tool's rotation free.

        Args:
            commanded: Tip positions in `work` [m], shape (step, 3).

        **Differentiability**: that of `inverse_kinematics_path`.
        """
        if self.arm is None:
            return JointRows(commanded, on_device(np.ones(commanded.shape[0], bool)))
        found = self.solve(commanded)
        return JointRows(found.q, found.converged)

    def poses(self, commanded: Float[Array, "step 3"]) -> Float[Array, "step 4 4"]:
        """Return the poses of the tool in the base for tip positions in `work`."""
        T = jnp.asarray(self.T_base_work)
        return _poses(T, commanded, self.tool_axes, self.tool_x)

    def motors(self, commanded: Float[Array, "step 3"]) -> "JointRows":
        """Return the motor positions of tip positions, and which of them are reached.

        Args:
            commanded: Tip positions in `work` [m], shape (step, 3).

        **Differentiability**: that of `inverse_kinematics_path`.
        """
        q, is_reached = self.joints(commanded)
        return JointRows(self.motor_positions_from_joints(q), is_reached)

    def motor_positions_from_joints(
        self, joints: Float[Array, "step joint"]
    ) -> Float[Array, "step machine_joint"]:
        """Return the motor positions for commanded joints, sag added if compensated.

        Args:
            joints: Commanded joint positions [rad or m], shape (step, joint).

        Returns:
            Positions of the machine's motors [rad or m], shape (step, joint).

        **Differentiability**: that of `motor_positions`.
        """
        if self.arm is None:
            return self.tool_command(joints)
        motors = lambda q: _motors(self.robot, q, self.is_gravity_compensated)
        if is_traced((self, joints)):
            return self._of_machine(motors(joints))
        return self._of_machine(on_device(in_pieces(motors, joints)))

    def tool_command(
        self, commanded: Float[Array, "step 3"]
    ) -> Float[Array, "step axis"]:
        """Return the command of a machine of modes: tips, and axes of a tilted tool."""
        axes = self.tool_axes
        if axes is None:
            return commanded
        return jnp.concatenate([commanded, axes.astype(commanded.dtype)], axis=1)

    def motor_slopes(
        self,
        joints: Float[Array, "step joint"],
        commanded: Float[Array, "step 3"] | None = None,
    ) -> Float[Array, "step machine_joint axis"]:
        """Slopes of the motors of each row in its command.

        Args:
            joints: Commanded joint positions [rad or m], shape (step, joint).
            commanded: Tip positions that they reach [m], shape (step, 3), whose change
                it is; None for that of the joints themselves.

        Returns:
            Slopes, shape (step, joint, axis).

        **Differentiability**: none is meant.
        """
        count, rows = joints.shape[0], joints.shape[0]
        if self.arm is None:
            axes = 3 if self.tool_axes is None else 6
            one = np.eye(axes, 3, dtype=joints.dtype)
            return on_device(np.broadcast_to(one[None], (count, axes, 3)))
        Ts = row_count = None
        if commanded is not None:
            Ts = self.poses(commanded)
        if not is_traced((self, joints, commanded)):
            rows = padded_count(count)
            joints = on_device(pad_rows(joints, rows))
            Ts = None if Ts is None else on_device(pad_rows(Ts, rows))
            row_count = on_device(np.asarray(count, np.int32))
        # Without rows of the path, for whose every length it would be compiled.
        rows_of_path = lambda known: (known.tool_axes, known.tool_x)
        known = eqx.tree_at(
            rows_of_path, self, (None, None), is_leaf=lambda x: x is None
        )
        found = _slopes(known, joints, Ts, row_count)
        return self._of_machine(first_rows(found, count))

    def _of_machine(
        self, motors: Float[Array, "step joint *axis"]
    ) -> Float[Array, "step machine_joint *axis"]:
        """Motors of the robot that the controller knows, at the machine's joints."""
        if self.motor_places is None:
            return motors
        return placed_motors(self.motor_places, motors)


@eqx.filter_jit
def _poses(
    T_base_work: Float[Array, "4 4"],
    commanded: Float[Array, "step 3"],
    axes: Float[Array, "step 3"] | None,
    tool_x: Float[Array, "step 3"] | Float[np.ndarray, "step 3"] | None,
) -> Float[Array, "step 4 4"]:
    tips = commanded @ T_base_work[:3, :3].T + T_base_work[:3, 3][None]
    Ts = jnp.broadcast_to(T_base_work[None], (commanded.shape[0], 4, 4))
    if axes is not None or tool_x is not None:
        z = Pose.along(commanded, axes).direction()
        if tool_x is None:
            frames = Pose.frame(z)
        else:
            x = jnp.asarray(tool_x, z.dtype)
            x = x - jnp.sum(x * z, axis=1, keepdims=True) * z
            x = x / jnp.linalg.norm(x, axis=1, keepdims=True)
            frames = jnp.stack([x, jnp.cross(z, x), z], axis=-1)
        Ts = Ts.at[:, :3, :3].set(T_base_work[None, :3, :3] @ frames.astype(Ts.dtype))
    return Ts.at[:, :3, 3].set(tips)


@eqx.filter_jit
def _motors(
    robot: Robot, joints: Float[Array, "step joint"], is_compensated: bool
) -> Float[Array, "step joint"]:
    return jax.vmap(
        lambda q: motor_positions(robot, q, is_gravity_compensated=is_compensated)
    )(joints)


@CachedJit
def _slopes(
    known: JobKinematics,
    joints: Float[Array, "step joint"],
    Ts: Float[Array, "step 4 4"] | None,
    row_count: Int[Array, ""] | None,
) -> Float[Array, "step joint axis"]:
    robot, is_compensated = known.robot, known.is_gravity_compensated
    R_base_work = jnp.asarray(known.T_base_work)[:3, :3]

    def by_joints(q: Float[Array, " joint"]) -> Float[Array, "joint joint"]:
        motors = lambda q: motor_positions(
            robot, q, is_gravity_compensated=is_compensated
        )
        return jax.jacfwd(motors)(q)

    def by_tip(
        q: Float[Array, " joint"], T: Float[Array, "4 4"]
    ) -> Float[Array, "joint 3"]:
        near = lambda p: (
            inverse_kinematics(
                robot,
                T.at[:3, 3].set(p),
                q,
                tool_rotation=known.tool_rotation,
                attempts=0,
            ).q
        )
        return jax.jacfwd(near)(T[:3, 3]) @ R_base_work

    def of_row(
        q: Float[Array, " joint"], T: Float[Array, "4 4"] | None
    ) -> Float[Array, "joint axis"]:
        return by_joints(q) if T is None else by_joints(q) @ by_tip(q, T)

    index = jnp.arange(joints.shape[0], dtype=jnp.int32)
    return map_rows(of_row, live_rows(index, row_count), joints, Ts)
