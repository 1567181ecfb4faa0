"""Measured poses and their prediction by a robot with link errors.

What is measured is the tool in the instrument's frame, in which T_base is roughly where
the robot's base stands:

    T = T_base . FK(q + w(q) - s(q); errors)

as a point, as a frame, or as the distance of the point from a fixed one. The sag s of
the joints under the arm's weight is known from its springs and masses, if it has any.
"""

from typing import Literal, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...robot import Robot, forward_kinematics, loaded_equilibrium
from .parameters import ErrorParameter, link_errors, placed

Observed: TypeAlias = Literal["position", "frame", "distance"]


class MeasuredPoses(eqx.Module):
    """Poses as an instrument has measured them.

    Attributes:
        q: Joint positions as the controller counts them [rad or m], (pose, joint).
        position: Of the tool's origin in the instrument's frame [m], shape (pose, 3);
            None for distances.
        rotation: Of the tool there, shape (pose, 3, 3); None if it was not measured.
        distance: Of the tool's origin from a fixed point [m], shape (pose,), or None.
        sag: By which the joints yield to the arm's weight [rad or m], (pose, joint);
            None for none.
    """

    q: Float[np.ndarray, "pose joint"]
    position: Float[np.ndarray, "pose 3"] | None = None
    rotation: Float[np.ndarray, "pose 3 3"] | None = None
    distance: Float[np.ndarray, " pose"] | None = None
    sag: Float[np.ndarray, "pose joint"] | None = None

    @property
    def observed(self) -> Observed:
        """Quantity of a pose that was measured."""
        if self.distance is not None:
            return "distance"
        return "position" if self.rotation is None else "frame"

    @property
    def groups(self) -> tuple[slice, ...]:
        """Components of a residual that have one noise: lengths, then angles."""
        if self.distance is not None:
            return (slice(0, 1),)
        return (slice(0, 3),) if self.rotation is None else (slice(0, 3), slice(3, 6))


class KinematicModel(eqx.Module):
    """Robot with unknown link errors, under an instrument.

    Attributes:
        robot: As stated, with the tool that was measured.
        T_base: Where its base roughly stands in the instrument's frame, shape (4, 4).
        fixed_point: In `base`, roughly, from which distances count [m], shape (3,).
        parameters: The unknowns.
        waves_per_turn: Waves of a gear in a turn of its joint.
    """

    robot: Robot
    T_base: Float[np.ndarray, "4 4"]
    fixed_point: Float[np.ndarray, " 3"]
    parameters: tuple[ErrorParameter, ...]
    waves_per_turn: float = eqx.field(static=True)

    @property
    def sizes(self) -> Float[np.ndarray, " unknown"]:
        """Standard deviations of the unknowns beforehand [m or rad]."""
        return np.array([one.size for one in self.parameters])

    def tool_poses(
        self, x: Float[Array, " unknown"], poses: MeasuredPoses
    ) -> Float[Array, "pose 4 4"]:
        """Poses of the tool in the instrument's frame, shape (pose, 4, 4).

        Args:
            x: The unknowns [m or rad], shape (unknown,).
            poses: Their joint positions and sag count.
        """
        errors = link_errors(self.parameters, x, self.robot, self.waves_per_turn)
        robot = errors.applied_to(self.robot)
        q = jax.vmap(robot.transmitted)(jnp.asarray(poses.q))
        q = q if poses.sag is None else q - poses.sag
        T_base = jnp.asarray(self.T_base)
        return jax.vmap(lambda q: T_base @ forward_kinematics(robot, q))(q)

    def residual(
        self, x: Float[Array, " unknown"], poses: MeasuredPoses
    ) -> Float[Array, "pose component"]:
        """Measured less predicted [m, rad], shape (pose, component).

        Angles are 2 sin(angle / 2) axis of the rotation from the predicted frame to the
        measured one, to third order.

        Args:
            x: The unknowns [m or rad], shape (unknown,).
            poses: What was measured.
        """
        Ts = self.tool_poses(x, poses)
        p = Ts[:, :3, 3]
        if poses.distance is not None:
            point = jnp.asarray(self.fixed_point)
            point = placed(self.parameters, x, "fixed_point", point)
            length = jnp.sqrt(jnp.sum((p - point[None]) ** 2, axis=1))
            return jnp.asarray(poses.distance - length)[:, None]
        off = jnp.asarray(poses.position) - p
        if poses.rotation is None:
            return off
        turn = jnp.asarray(poses.rotation) @ jnp.swapaxes(Ts[:, :3, :3], 1, 2)
        vector = [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0]]
        vector += [turn[:, 1, 0] - turn[:, 0, 1]]
        return jnp.concatenate([off, 0.5 * jnp.stack(vector, axis=1)], axis=1)


def weight_sag(
    robot: Robot, q: Float[np.ndarray, "pose joint"]
) -> Float[np.ndarray, "pose joint"] | None:
    """Yielding of the joints to the arm's own weight [rad or m], (pose, joint).

    Args:
        robot: The robot; None is returned where it has no springs or no masses.
        q: Motor positions [rad or m], shape (pose, joint).
    """
    is_soft = np.isfinite(np.asarray(robot.joint_stiffness)).any()
    if not is_soft or not np.asarray(robot.link_masses).any():
        return None
    balance = jax.jit(jax.vmap(lambda q: loaded_equilibrium(robot, q)))
    return q - np.asarray(balance(jnp.asarray(q)))


@eqx.filter_jit
def residual(
    model: KinematicModel, x: Float[Array, " unknown"], poses: MeasuredPoses
) -> Float[Array, "pose component"]:
    """Compiled `KinematicModel.residual`."""
    return model.residual(x, poses)


@eqx.filter_jit
def residual_slopes(
    model: KinematicModel, x: Float[Array, " unknown"], poses: MeasuredPoses
) -> Float[Array, "pose component unknown"]:
    """Derivatives of the residual, shape (pose, component, unknown)."""
    return jax.jacfwd(model.residual)(x, poses)


def placed_instrument(robot: Robot, poses: MeasuredPoses) -> "PlacedInstrument":
    """Base and tool that bring a robot as stated closest to measured poses.

    Base: the rotation and displacement between the two sets of points (Kabsch 1976).
    Tool: the mean rotation between predicted and measured frames.

    Args:
        robot: The robot.
        poses: What was measured.

    Returns:
        The robot with its tool turned, and its base in the instrument's frame.
    """
    if poses.position is None:
        return PlacedInstrument(robot, np.eye(4))
    q = poses.q if poses.sag is None else poses.q - poses.sag
    Ts = np.asarray(jax.vmap(lambda q: forward_kinematics(robot, q))(jnp.asarray(q)))
    p, y = Ts[:, :3, 3], poses.position
    R = _nearest_rotation((y - y.mean(axis=0)).T @ (p - p.mean(axis=0)))
    T_base = np.eye(4)
    T_base[:3, :3] = R
    T_base[:3, 3] = y.mean(axis=0) - R @ p.mean(axis=0)
    if poses.rotation is not None:
        turns = np.swapaxes(R[None] @ Ts[:, :3, :3], 1, 2) @ poses.rotation
        T_tool = np.eye(4)
        T_tool[:3, :3] = _nearest_rotation(turns.sum(axis=0))
        robot = robot.with_tool(np.asarray(robot.T_flange_tool) @ T_tool)
    return PlacedInstrument(robot, T_base)


class PlacedInstrument(eqx.Module):
    """Robot and its base in the frame of an instrument.

    Attributes:
        robot: With the tool as it was measured.
        T_base: Its base there, shape (4, 4).
    """

    robot: Robot
    T_base: Float[np.ndarray, "4 4"]


def _nearest_rotation(matrix: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """Rotation R that makes trace(R^T M) largest."""
    U, _, V = np.linalg.svd(matrix)
    return U @ np.diag([1.0, 1.0, np.linalg.det(U @ V)]) @ V
