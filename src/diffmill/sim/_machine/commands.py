"""From the tips that a program commands to the motors of the job's robot.

Inverse kinematics takes long to compile. On the host it runs by programs of its own, of
few lengths, which all that need joints or motors share.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..._arrays import first_rows, is_traced, on_device
from ..._job import Job
from ..._padding import live_rows, map_rows, pad_rows, padded_count
from ...numerics import CachedJit
from ...robot import (
    JointSolution,
    Robot,
    inverse_kinematics,
    inverse_kinematics_path,
    motor_positions,
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
    """What the machine of a job does to follow the tips that a program commands.

    A machine of modes has no joints: its drives are where the tip is.

    Attributes:
        job: The job, in its precision; its machine must not be rigid.
    """

    job: Job

    @property
    def robot(self) -> Robot:
        """The robot.

        Raises:
            ValueError: The job has none.
        """
        if self.job.robot is None:
            raise ValueError(
                "Argument `job` must have a robot, but its machine is rigid."
            )
        return self.job.robot

    def solve(self, commanded: Float[Array, "step 3"]) -> JointSolution:
        """Return what inverse kinematics finds for tip positions, as `joints`."""
        robot = self.robot
        axes, tool_x = self.job.tool_axes, self.job.path.tool_x
        start = (
            robot.home
            if self.job.joint_start is None
            else jnp.asarray(self.job.joint_start)
        )
        count, rows = commanded.shape[0], commanded.shape[0]
        if not is_traced((self.job, commanded)):
            rows = padded_count(count)
            commanded = on_device(pad_rows(commanded, rows))
            axes = None if axes is None else on_device(pad_rows(axes, rows))
            tool_x = None if tool_x is None else on_device(pad_rows(tool_x, rows))
        Ts = _poses(jnp.asarray(self.job.T_base_work), commanded, axes, tool_x)
        return inverse_kinematics_path(
            robot,
            first_rows(Ts, count),
            start,
            tool_rotation=self.job.tool_rotation,
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
        if self.job.modes is not None:
            return JointRows(commanded, on_device(np.ones(commanded.shape[0], bool)))
        found = self.solve(commanded)
        return JointRows(found.q, found.converged)

    def poses(self, commanded: Float[Array, "step 3"]) -> Float[Array, "step 4 4"]:
        """Return the poses of the tool in the base for tip positions in `work`."""
        T, path = jnp.asarray(self.job.T_base_work), self.job.path
        return _poses(T, commanded, self.job.tool_axes, path.tool_x)

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
    ) -> Float[Array, "step joint"]:
        """Return the motor positions for commanded joints, sag added if compensated.

        Args:
            joints: Commanded joint positions [rad or m], shape (step, joint).

        Returns:
            Motor positions [rad or m], shape (step, joint).

        **Differentiability**: that of `motor_positions`.
        """
        if self.job.modes is not None:
            return self.tool_command(joints)
        count, rows = joints.shape[0], joints.shape[0]
        if not is_traced((self.job, joints)):
            rows = padded_count(count)
            joints = on_device(pad_rows(joints, rows))
        is_compensated = self.job.simulation.is_gravity_compensated
        motors = _motors(self.robot, joints, is_compensated)
        return first_rows(motors, count)

    def tool_command(
        self, commanded: Float[Array, "step 3"]
    ) -> Float[Array, "step axis"]:
        """Return the command of a machine of modes: tips, and axes of a tilted tool."""
        axes = self.job.tool_axes
        if axes is None:
            return commanded
        return jnp.concatenate([commanded, axes.astype(commanded.dtype)], axis=1)

    def motor_slopes(
        self,
        joints: Float[Array, "step joint"],
        commanded: Float[Array, "step 3"] | None = None,
    ) -> Float[Array, "step joint axis"]:
        """Return how the motors of each row change with its command.

        Args:
            joints: Commanded joint positions [rad or m], shape (step, joint).
            commanded: Tip positions that they reach [m], shape (step, 3), whose change
                it is; None for that of the joints themselves.

        Returns:
            Slopes, shape (step, joint, axis).

        **Differentiability**: none is meant.
        """
        count, rows = joints.shape[0], joints.shape[0]
        if self.job.modes is not None:
            axes = 3 if self.job.tool_axes is None else 6
            one = np.eye(axes, 3, dtype=joints.dtype)
            return on_device(np.broadcast_to(one[None], (count, axes, 3)))
        Ts = row_count = None
        if commanded is not None:
            Ts = self.poses(commanded)
        if not is_traced((self.job, joints, commanded)):
            rows = padded_count(count)
            joints = on_device(pad_rows(joints, rows))
            Ts = None if Ts is None else on_device(pad_rows(Ts, rows))
            row_count = on_device(np.asarray(count, np.int32))
        found = _slopes(_Slopes(self.job, self.robot), joints, Ts, row_count)
        return first_rows(found, count)


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


class _Slopes(eqx.Module):
    """What the slopes of motors need of a job."""

    robot: Robot
    R_base_work: Float[Array, "3 3"]
    tool_rotation: Any = eqx.field(static=True)
    is_compensated: bool = eqx.field(static=True)

    def __init__(self, job: Job, robot: Robot):
        self.robot = robot
        self.R_base_work = jnp.asarray(job.T_base_work)[:3, :3]
        self.tool_rotation = job.tool_rotation
        self.is_compensated = job.simulation.is_gravity_compensated


@CachedJit
def _slopes(
    known: _Slopes,
    joints: Float[Array, "step joint"],
    Ts: Float[Array, "step 4 4"] | None,
    row_count: Int[Array, ""] | None,
) -> Float[Array, "step joint axis"]:
    robot, is_compensated = known.robot, known.is_compensated

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
        return jax.jacfwd(near)(T[:3, 3]) @ known.R_base_work

    def of_row(
        q: Float[Array, " joint"], T: Float[Array, "4 4"] | None
    ) -> Float[Array, "joint axis"]:
        return by_joints(q) if T is None else by_joints(q) @ by_tip(q, T)

    index = jnp.arange(joints.shape[0], dtype=jnp.int32)
    return map_rows(of_row, live_rows(index, row_count), joints, Ts)
