"""The arm as points and lines, for figures."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._algebra.spatial import apply_matrix
from .._model.mimic import unfold_positions
from .._model.robot import JointVector, Robot, joint_vector
from .forward import joint_frames


class Skeleton(eqx.Module):
    """Line figure of an arm: places of its joints, all in `base`.

    Attributes:
        mounts: Origin of each joint with its slide at 0 [m], shape (body, 3); the
            joint's own origin for a turn.
        origins: Origin of each body's joint [m], shape (body, 3).
        axes: Direction of each joint, shape (body, 3).
        flange: [m], shape (3,).
        tool: Tip of the tool [m], shape (3,).
        tool_rotation: Tool axes, as columns, shape (3, 3).
    """

    mounts: Float[Array, "body 3"]
    origins: Float[Array, "body 3"]
    axes: Float[Array, "body 3"]
    flange: Float[Array, " 3"]
    tool: Float[Array, " 3"]
    tool_rotation: Float[Array, "3 3"]

    @classmethod
    def of_robot(cls, robot: Robot, q: JointVector) -> "Skeleton":
        """Line figure of a robot.

        Args:
            robot: The robot.
            q: Joint positions [rad or m], shape (joint,).

        Returns:
            The points; `robot.parents` shows which belong together.
        """
        values = joint_vector(robot, q, "q")
        frames = joint_frames(robot, values)
        slides = robot.prismatic_mask()
        travel = jnp.where(slides, unfold_positions(robot, values), 0.0)
        axes = frames.rotations[:, :, 2]
        flange = robot.T_joint_flange[:3, 3]
        if robot.flange_joint >= 0:
            R = frames.rotations[robot.flange_joint]
            flange = frames.positions[robot.flange_joint] + apply_matrix(R, flange)
        return cls(
            mounts=frames.positions - travel[:, None] * axes,
            origins=frames.positions,
            axes=axes,
            flange=flange,
            tool=frames.tool_position,
            tool_rotation=frames.tool_rotation,
        )
