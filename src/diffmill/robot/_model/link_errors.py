"""Geometric errors of a robot: joints that stand and point otherwise than stated.

A joint's error acts in its own frame, before it turns, so that its axis is z there:

    T_base_tool = T_base . Prod_i [ placement_i . error_i . joint_i(q_i + offset_i) ]
                  . T_joint_flange . T_flange_tool . T_tool

error_i, T_base and T_tool each are a displacement and then a rotation by a rotation
vector. Gear waves are the motor's: its joint stands at q = theta + w(theta).
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._types import RealScalarLike
from .._algebra.rotations import rotation_matrix
from .._algebra.spatial import apply_matrix, matrix_product
from .drives import GearWaves
from .mimic import unfold_rates
from .robot import Robot


class LinkErrors(eqx.Module):
    """Geometric errors of a robot's joints, tool and base.

    Attributes:
        displacement: Of each joint's frame, in its axes [m], shape (joint, 3).
        rotation: Rotation vector of each joint's frame, in its axes [rad], shape
            (joint, 3).
        joint_offsets: Added to the joint positions [rad or m], shape (joint,).
        tool_position: Displacement of the tool in its own axes [m], shape (3,).
        tool_rotation: Rotation vector of the tool in its own axes [rad], shape (3,).
        base_position: Origin of the robot's base in the frame in which its poses are
            told [m], shape (3,).
        base_rotation: Rotation vector of the base there [rad], shape (3,).
        waves: Gear waves: amplitudes of sin and cos of k q and of 2 k q [rad], shape
            (joint, 4); None for even gears.
        waves_per_turn: k [-].
    """

    displacement: Float[Array, "joint 3"]
    rotation: Float[Array, "joint 3"]
    joint_offsets: Float[Array, " joint"]
    tool_position: Float[Array, " 3"]
    tool_rotation: Float[Array, " 3"]
    base_position: Float[Array, " 3"]
    base_rotation: Float[Array, " 3"]
    waves: Float[Array, "joint 4"] | None = None
    waves_per_turn: RealScalarLike = 1.0

    @classmethod
    def none(cls, robot: Robot) -> "LinkErrors":
        """Errors of 0 for a robot, without gear waves.

        Args:
            robot: The robot.
        """
        zeros = lambda *shape: jnp.zeros(shape, robot.dtype)
        n = robot.joint_count
        return cls(
            displacement=zeros(n, 3),
            rotation=zeros(n, 3),
            joint_offsets=zeros(n),
            tool_position=zeros(3),
            tool_rotation=zeros(3),
            base_position=zeros(3),
            base_rotation=zeros(3),
        )

    def with_more_joints(self, robot: Robot) -> "LinkErrors":
        """Errors of 0 added for the virtual joints behind an arm.

        Args:
            robot: The arm with the springs of its flange and its tool.
        """
        n = robot.joint_count
        pad = lambda rows: jnp.pad(
            rows, ((0, n - len(rows)), *[(0, 0)] * (rows.ndim - 1))
        )
        return dataclasses.replace(
            self,
            displacement=pad(self.displacement),
            rotation=pad(self.rotation),
            joint_offsets=pad(self.joint_offsets),
            waves=None if self.waves is None else pad(self.waves),
        )

    def applied_to(self, robot: Robot) -> Robot:
        """Robot with these errors.

        Joint positions stay those that its controller counts: limits and home are as
        they were. Masses move with their links.

        Args:
            robot: The robot as stated, with its tool.

        Returns:
            The robot as it is.

        Raises:
            ValueError: An error has another shape than (joint, ...).
        """
        self._check_shapes(robot)
        R, p = robot.placement_rotations, robot.placement_positions
        own = np.array([body for body, m in enumerate(robot.mimics) if m is None])
        turns = jax.vmap(rotation_matrix)(self.rotation)
        p = p.at[own].add(apply_matrix(R[own], self.displacement))
        R = R.at[own].set(matrix_product(R[own], turns))
        # An offset is the joint's own motion, and that of those that follow it.
        offsets, slides = (
            unfold_rates(robot, self.joint_offsets),
            robot.prismatic_mask(),
        )
        p = p + R[:, :, 2] * jnp.where(slides, offsets, 0.0)[:, None]
        angle = jnp.where(slides, 0.0, offsets)
        about_z = jnp.stack([0.0 * angle, 0.0 * angle, angle], axis=-1)
        R = matrix_product(R, jax.vmap(rotation_matrix)(about_z))
        R_base = rotation_matrix(self.base_rotation)
        is_root = np.array(robot.parents) < 0
        moved = jax.vmap(lambda p: apply_matrix(R_base, p) + self.base_position)(p)
        turned = jax.vmap(lambda R: matrix_product(R_base, R))(R)
        R_tool = rotation_matrix(self.tool_rotation)
        T_tool = jnp.eye(4, dtype=R.dtype).at[:3, :3].set(R_tool)
        T_tool = T_tool.at[:3, 3].set(self.tool_position)
        waves = robot.gear_waves
        if self.waves is not None:
            per_turn = jnp.asarray(self.waves_per_turn, robot.dtype)
            waves = GearWaves(self.waves, per_turn)
        return dataclasses.replace(
            robot,
            placement_rotations=jnp.where(is_root[:, None, None], turned, R),
            placement_positions=jnp.where(is_root[:, None], moved, p),
            T_flange_tool=matrix_product(robot.T_flange_tool, T_tool),
            gravity=apply_matrix(R_base, robot.gravity),
            gear_waves=waves,
        )

    def _check_shapes(self, robot: Robot) -> None:
        """Raise if an error has not one row per joint."""
        wanted = {"displacement": (3,), "rotation": (3,), "joint_offsets": ()}
        if self.waves is not None:
            wanted["waves"] = (4,)
        for name, row in wanted.items():
            shape = (robot.joint_count, *row)
            found = jnp.shape(getattr(self, name))
            if found != shape:
                raise ValueError(
                    f"Argument `{name}` must have the shape {shape} for "
                    f"{robot.name!r} ({', '.join(robot.joint_names)}), but has {found}."
                )
