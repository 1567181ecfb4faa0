"""Springs in series behind a robot: virtual joints between its flange and its tool."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._types import RealScalarLike
from .._algebra.spatial import apply_matrix, matrix_product
from .drives import Backlash, Friction, GearWaves, Motors
from .robot import Robot


class Spring(eqx.Module):
    """A virtual joint to append.

    Attributes:
        stiffness: K [N m/rad or N/m].
        damping: D [N m s/rad or N s/m].
        name: Name of the joint.
        kind: "revolute" or "prismatic".
        axis: 0, 1 or 2: x, y or z of the frame of the springs.
    """

    stiffness: RealScalarLike
    damping: RealScalarLike
    name: str = eqx.field(static=True)
    kind: str = eqx.field(static=True)
    axis: int = eqx.field(static=True)


class Body(eqx.Module):
    """Body behind the springs.

    Attributes:
        mass: [kg].
        center: Its centre in the frame of the springs [m], shape (3,).
        inertia: About the centre, axes of that frame [kg m^2], shape (3, 3).
    """

    mass: Float[Array, ""]
    center: Float[Array, " 3"]
    inertia: Float[Array, "3 3"]


def with_series_springs(
    robot: Robot,
    springs: Sequence[Spring],
    body: Body,
    T_flange_springs: Float[Array, "4 4"],
) -> Robot:
    """Robot with springs in series between its flange and its tool.

    Args:
        robot: The robot.
        springs: One after the other; with all at 0 the tool is where it was.
        body: Body on the last spring.
        T_flange_springs: Frame in which they act, in the flange's, shape (4, 4).

    Returns:
        The robot; its flange is behind the springs.

    Raises:
        ValueError: If a joint already has a spring's name.
    """
    taken = sorted({s.name for s in springs} & set(robot.joint_names))
    if taken:
        raise ValueError(f"Joint names must be unique, but occur twice: {taken}.")
    dtype, count = robot.dtype, len(springs)
    # Rotations that turn z to the axes of the springs, by changing names.
    aligns = [np.roll(np.eye(3), spring.axis + 1, axis=0) for spring in springs]
    turns = [b.T @ a for a, b in zip(aligns[1:], aligns[:-1], strict=True)]
    to_end = jnp.asarray(aligns[-1].T, dtype)
    T_first = matrix_product(robot.T_joint_flange, T_flange_springs)
    first = matrix_product(T_first[:3, :3], jnp.asarray(aligns[0], dtype))
    others = [jnp.asarray(turn, dtype) for turn in turns]
    R, p = T_flange_springs[:3, :3], T_flange_springs[:3, 3]
    # Back from the springs to the flange's own frame.
    back = matrix_product(to_end, R.T)
    top = jnp.concatenate([back, -apply_matrix(back, p)[:, None]], axis=1)
    bottom = jnp.eye(4, dtype=dtype)[3:]
    inertia = matrix_product(matrix_product(to_end, body.inertia), to_end.T)
    column = lambda name: jnp.stack(
        [jnp.asarray(getattr(spring, name), dtype) for spring in springs]
    )
    none, free = jnp.zeros(count, dtype), jnp.full(count, jnp.inf, dtype)
    join = lambda old, *new: jnp.concatenate([old, *new])
    last = lambda value: jnp.concatenate(
        [jnp.zeros((count - 1, *value.shape), dtype), value[None]]
    )
    own = range(robot.body_count, robot.body_count + count)
    return dataclasses.replace(
        robot,
        placement_rotations=join(
            robot.placement_rotations, jnp.stack([first, *others])
        ),
        placement_positions=join(
            robot.placement_positions,
            T_first[None, :3, 3],
            jnp.zeros((count - 1, 3), dtype),
        ),
        link_masses=join(robot.link_masses, last(body.mass)),
        link_centers=join(robot.link_centers, last(apply_matrix(to_end, body.center))),
        link_inertias=join(robot.link_inertias, last(inertia)),
        T_joint_flange=jnp.concatenate([top, bottom]),
        joint_stiffness=join(robot.joint_stiffness, column("stiffness")),
        joint_damping=join(robot.joint_damping, column("damping")),
        joint_lower=join(robot.joint_lower, -free),
        joint_upper=join(robot.joint_upper, free),
        home=join(robot.home, none),
        joint_speed=None
        if robot.joint_speed is None
        else join(robot.joint_speed, free),
        joint_names=(*robot.joint_names, *(spring.name for spring in springs)),
        body_kinds=(*robot.body_kinds, *(spring.kind for spring in springs)),
        parents=(*robot.parents, robot.flange_joint, *own[:-1]),
        is_virtual=(*robot.is_virtual, *[True] * count),
        flange_joint=own[-1],
        mimics=(*robot.mimics, *[None] * count),
        **_plain_drives(robot, count),
    )


def _plain_drives(robot: Robot, count: int) -> dict[str, eqx.Module | None]:
    """Drives' options with none of them in the joints to come."""
    extend = lambda values, more: jnp.concatenate(
        [values, jnp.full(count, more, values.dtype)]
    )
    gaps, friction, motors = robot.backlash, robot.friction, robot.motors
    if gaps is not None:
        gaps = Backlash(extend(gaps.gap, 0.0), gaps.corner)
    if friction is not None:
        friction = Friction(
            extend(friction.coulomb, 0.0),
            extend(friction.viscous, 0.0),
            extend(friction.speed, 1.0),
            None if friction.presliding is None else extend(friction.presliding, 0.0),
        )
    if motors is not None:
        motors = Motors(
            extend(motors.inertia, 1.0),
            extend(motors.stiffness, 1.0),
            extend(motors.damping, 0.0),
        )
    waves = robot.gear_waves
    if waves is not None:
        none = jnp.zeros((count, 4), waves.amplitudes.dtype)
        waves = GearWaves(jnp.concatenate([waves.amplitudes, none]), waves.per_turn)
    return {
        "backlash": gaps,
        "friction": friction,
        "motors": motors,
        "gear_waves": waves,
    }
