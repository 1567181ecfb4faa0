"""Forward kinematics: poses of joints and tool, and the tool's Jacobian.

Everything is written in base axes about the tool's origin: the joints' screws are
then the columns of the Jacobian, and spatial vectors of different links add without
transformation. The walk over the joints is unrolled; all else is one operation on
all joints at once. Measured on a CPU inside a scan, this is as fast as a scan over
the joints and works for trees.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._algebra.spatial import apply_matrix, cross, inertia_rows, matrix_product
from .._model.mimic import fold, unfold_positions
from .._model.robot import JointVector, Robot, joint_vector


class JointFrames(eqx.Module):
    """Frames and screws of one joint configuration.

    Attributes:
        rotations: Link axes in `base`, shape (body, 3, 3).
        positions: Joint origins in `base` [m], shape (body, 3).
        tool_rotation: Tool axes in `base`, shape (3, 3).
        tool_position: Tool origin in `base` [m], shape (3,).
        screws: Velocity of a body at the tool's origin per unit joint velocity,
            linear part first, shape (body, 6); `fold` gives those of the joint vector.
    """

    rotations: Float[Array, "body 3 3"]
    positions: Float[Array, "body 3"]
    tool_rotation: Float[Array, "3 3"]
    tool_position: Float[Array, " 3"]
    screws: Float[Array, "body 6"]


def joint_frames(robot: Robot, q: Float[Array, " joint"]) -> JointFrames:
    """Frames and screws; see `JointFrames`."""
    local = jnp.unstack(_local_frames(robot, unfold_positions(robot, q)))
    # Three rows of a frame times a whole local one: rotation and place at once, in half
    # the instructions of a product for each.
    frames: list[Array] = []
    for i, parent in enumerate(robot.parents):
        T = local[i]
        frames.append(T[:3] if parent < 0 else matrix_product(frames[parent], T))
    tool = matrix_product(robot.T_joint_flange, robot.T_flange_tool)
    if robot.flange_joint >= 0:
        tool = matrix_product(frames[robot.flange_joint], tool)
    stacked = jnp.stack(frames)
    rotations, positions = stacked[:, :, :3], stacked[:, :, 3]
    tool_position = tool[:3, 3]
    return JointFrames(
        rotations=rotations,
        positions=positions,
        tool_rotation=tool[:3, :3],
        tool_position=tool_position,
        screws=_screws(robot, rotations[:, :, 2], positions, tool_position),
    )


def _local_frames(robot: Robot, q: Float[Array, " body"]) -> Float[Array, "body 4 4"]:
    """Each link's frame in its parent's."""
    R, p = robot.placement_rotations, robot.placement_positions
    slides = robot.prismatic_mask()
    angle = q
    if slides.any():
        angle = jnp.where(slides, 0.0, q)
        p = p + R[:, :, 2] * jnp.where(slides, q, 0.0)[:, None]
    s, c = jnp.sin(angle)[:, None], jnp.cos(angle)[:, None]
    x, y, z = R[:, :, 0], R[:, :, 1], R[:, :, 2]
    frames = jnp.stack([x * c + y * s, y * c - x * s, z, p], axis=-1)
    last = jnp.broadcast_to(jnp.eye(4, dtype=q.dtype)[3], (robot.body_count, 1, 4))
    return jnp.concatenate([frames, last], axis=1)


def _screws(
    robot: Robot,
    axes: Float[Array, "body 3"],
    origins: Float[Array, "body 3"],
    tool_position: Float[Array, " 3"],
) -> Float[Array, "body 6"]:
    """Joints' screws about the tool's origin."""
    linear, angular = cross(axes, tool_position[None] - origins), axes
    slides = robot.prismatic_mask()[:, None]
    if slides.any():
        linear = jnp.where(slides, axes, linear)
        angular = jnp.where(slides, 0.0, angular)
    return jnp.concatenate([linear, angular], axis=-1)


def tool_transform(frames: JointFrames) -> Float[Array, "4 4"]:
    """T_base_tool of known frames."""
    top = jnp.concatenate(
        [frames.tool_rotation, frames.tool_position[:, None]], axis=-1
    )
    bottom = jnp.eye(4, dtype=top.dtype)[3:]
    return jnp.concatenate([top, bottom], axis=0)


def tool_jacobian(robot: Robot, frames: JointFrames) -> Float[Array, "6 joint"]:
    """Jacobian of known frames: the screws of joints that move the tool."""
    moves, screws = robot.tool_mask(), frames.screws
    if not moves.all():
        screws = jnp.where(moves[:, None], screws, 0.0)
    return fold(robot, screws).T


def link_inertia_rows(robot: Robot, frames: JointFrames) -> Float[Array, "body 13"]:
    """Links' inertias in base axes about the tool's origin."""
    R = frames.rotations
    centers = (
        apply_matrix(R, robot.link_centers)
        + frames.positions
        - frames.tool_position[None]
    )
    turned = matrix_product(
        matrix_product(R, robot.link_inertias), jnp.swapaxes(R, 1, 2)
    )
    return inertia_rows(robot.link_masses, centers, turned)


def forward_kinematics(robot: Robot, q: JointVector) -> Float[Array, "4 4"]:
    """Pose of the tool in the robot's base.

    Args:
        robot: The robot.
        q: Joint positions [rad or m], shape (joint,).

    Returns:
        T_base_tool: maps tool coordinates to base, shape (4, 4).
    """
    return _forward_kinematics(robot, joint_vector(robot, q, "q"))


def jacobian(robot: Robot, q: JointVector) -> Float[Array, "6 joint"]:
    """Jacobian: twist of the tool at its origin, in base axes.

    Args:
        robot: The robot.
        q: Joint positions [rad or m], shape (joint,).

    Returns:
        Linear rows [m/rad or -] first, then angular [- or rad/m], shape (6, joint).
    """
    return _jacobian(robot, joint_vector(robot, q, "q"))


@jax.jit
def _forward_kinematics(robot: Robot, q: Float[Array, " joint"]) -> Float[Array, "4 4"]:
    return tool_transform(joint_frames(robot, q))


@jax.jit
def _jacobian(robot: Robot, q: Float[Array, " joint"]) -> Float[Array, "6 joint"]:
    return tool_jacobian(robot, joint_frames(robot, q))
