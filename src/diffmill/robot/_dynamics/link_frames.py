"""Frames of the links, number by number: both walks over a robot begin with them."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ...numerics import materialise
from .._algebra.scalars import (
    Matrix,
    Vector,
    add,
    dot,
    numbers,
    scale,
    transpose,
)
from .._model.robot import Robot


class LinkFrame(NamedTuple):
    """A link's frame in its parent's."""

    rotation: Matrix
    position: Vector


def link_frames(robot: Robot, q: Vector) -> list[LinkFrame]:
    """Frames of all links, each in its parent's.

    Args:
        robot: The robot.
        q: Position of the joint of every body [rad or m].
    """
    frames = []
    rotations = numbers(robot.placement_rotations, 3)
    positions = numbers(robot.placement_positions, 2)
    slides = robot.prismatic_mask()
    for i, (R, p, q_i) in enumerate(zip(rotations, positions, q, strict=True)):
        x, y, z = transpose(R)
        if slides[i]:
            frames.append(materialise(LinkFrame(R, add(p, scale(q_i, z)))))
            continue
        s, c = materialise((jnp.sin(q_i), jnp.cos(q_i)))
        x, y = add(scale(c, x), scale(s, y)), add(scale(c, y), scale(-s, x))
        frames.append(materialise(LinkFrame(transpose((x, y, z)), p)))
    return frames


def tool_origin(robot: Robot) -> Vector:
    """Tool's origin in the frame of the body that carries the flange [m]."""
    T_joint_flange = numbers(robot.T_joint_flange, 2)
    tip = tuple(row[3] for row in numbers(robot.T_flange_tool, 2)[:3])
    return tuple(dot(row[:3], tip) + row[3] for row in T_joint_flange[:3])


def base_acceleration(robot: Robot, like: Float[Array, "..."]) -> Vector:
    """Upward acceleration of the base that gravity is, linear part first."""
    zero = jnp.zeros_like(like)
    upward: tuple[Array, ...] = tuple(zero - g for g in numbers(robot.gravity, 1))
    return upward + (zero,) * 3
