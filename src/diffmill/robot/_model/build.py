"""Compile elements into a `Robot`.

One walk over the elements keeps the current link and the current frame in it. A
joint's frame is turned so that its axis is z, and turned back behind it: elements
never see this, and the algorithms need no axis.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array

from ..._arrays import on_device
from .elements import (
    AbstractElement,
    Drive,
    FixedRotation,
    FixedTranslation,
    Fork,
    PrismaticJoint,
    RevoluteJoint,
    RigidBody,
    Tool,
)
from .robot import Robot

# The Earth's mean value is not meant: this one is the project's convention.
_GRAVITY = (0.0, 0.0, -9.81)


class _Mass(NamedTuple):
    """Mass [kg], its centre [m] and the inertia about it [kg m^2], in a link."""

    mass: float
    center: np.ndarray
    inertia: np.ndarray


class _Place(NamedTuple):
    """A link, -1 for the base, a frame in it, and a tool in that frame."""

    link: int
    frame: np.ndarray
    tool: np.ndarray


@dataclasses.dataclass
class _Walk:
    """State of the walk over the elements."""

    joints: list[RevoluteJoint | PrismaticJoint] = dataclasses.field(
        default_factory=list
    )
    parents: list[int] = dataclasses.field(default_factory=list)
    placements: list[np.ndarray] = dataclasses.field(default_factory=list)
    bodies: list[list[_Mass]] = dataclasses.field(default_factory=list)
    tools: dict[str, _Place] = dataclasses.field(default_factory=dict)


def build(
    elements: Sequence[AbstractElement], *, tool: str | None = None, name: str = "robot"
) -> Robot:
    """Compile a sequence of elements into a robot.

    Args:
        elements: From the base outwards. Without a `Tool` the end of the sequence
            is both flange and tool.
        tool: Name of the tool to use; may be left out if there is only one.
        name: Name of the model.

    Returns:
        The robot. Bodies before the first joint belong to the base and are dropped.

    Raises:
        ValueError: If there is no joint, a name occurs twice, or the tool is not
            there or not unique, or a joint mimics one that is not there or itself.

    **Differentiability**: none; differentiate by the arrays of the `Robot`.
    """
    walk = _Walk()
    end = _visit(walk, elements, -1, np.eye(4))
    if not walk.joints:
        raise ValueError("Argument `elements` must contain at least one joint.")
    names = [joint.name for joint in walk.joints]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise ValueError(f"Joint names must be unique, but occur twice: {twice}.")
    flange = _choose_tool(walk, end, tool)
    bodies = [_merge(each) for each in walk.bodies]
    placements = np.stack(walk.placements)
    mimics = _resolve_mimics(walk.joints)
    joints = [j for j in walk.joints if j.mimic is None]
    column = lambda field: _array([float(getattr(j, field)) for j in joints])
    robot = Robot(
        placement_rotations=_array(placements[:, :3, :3]),
        placement_positions=_array(placements[:, :3, 3]),
        link_masses=_array([body.mass for body in bodies]),
        link_centers=_array([body.center for body in bodies]),
        link_inertias=_array([body.inertia for body in bodies]),
        T_joint_flange=_array(flange.frame),
        T_flange_tool=_array(flange.tool),
        joint_stiffness=column("stiffness"),
        joint_damping=column("damping"),
        joint_lower=column("lower"),
        joint_upper=column("upper"),
        home=column("home"),
        gravity=_array(_GRAVITY),
        name=name,
        joint_names=tuple(j.name for j in joints),
        body_kinds=tuple(
            "prismatic" if isinstance(j, PrismaticJoint) else "revolute"
            for j in walk.joints
        ),
        parents=tuple(walk.parents),
        is_virtual=tuple(j.is_virtual for j in joints),
        flange_joint=flange.link,
        mimics=mimics,
        joint_speed=column("speed"),
    )
    return _with_drive_options(robot, [j.drive for j in joints])


def _array(values: Sequence[Any] | np.ndarray) -> Array:
    """Numbers on the device."""
    return on_device(np.asarray(values, float))


def _visit(
    walk: _Walk, elements: Sequence[AbstractElement], link: int, frame: np.ndarray
) -> _Place:
    """Walk along one branch; return its end as a tool."""
    for element in elements:
        match element:
            case FixedRotation():
                frame = frame @ _transform(element.rotation, np.zeros(3))
            case FixedTranslation():
                frame = frame @ _transform(np.eye(3), element.position)
            case RigidBody():
                if link >= 0:
                    walk.bodies[link].append(_body_in_link(element, frame))
            case Fork():
                for branch in element.branches:
                    _visit(walk, branch, link, frame)
            case Tool():
                if element.name in walk.tools:
                    raise ValueError(f"Two tools have the name {element.name!r}.")
                placed = _transform(element.rotation, element.position)
                walk.tools[element.name] = _Place(link, frame, placed)
            case RevoluteJoint() | PrismaticJoint():
                align = _transform(_rotation_of_z_to(element.axis), np.zeros(3))
                walk.joints.append(element)
                walk.parents.append(link)
                walk.placements.append(frame @ align)
                walk.bodies.append([])
                link, frame = len(walk.joints) - 1, align.T
            case _:
                raise ValueError(
                    "Argument `elements` must contain elements of diffmill.robot, "
                    f"but contains {element!r}."
                )
    return _Place(link, frame, np.eye(4))


def _resolve_mimics(
    joints: Sequence[RevoluteJoint | PrismaticJoint],
) -> tuple[tuple[int, float, float] | None, ...]:
    """`Robot.mimics`: chains of followers end at an independent joint.

    Raises:
        ValueError: If a joint follows one that is not there, or in the end itself.
    """
    by_name = {joint.name: joint for joint in joints}
    independent = [joint.name for joint in joints if joint.mimic is None]
    resolved: list[tuple[int, float, float] | None] = []
    for joint in joints:
        name, multiplier, offset, seen = joint.name, 1.0, 0.0, {joint.name}
        while (mimic := by_name[name].mimic) is not None:
            name = mimic.joint
            if name not in by_name:
                raise ValueError(
                    f"Joint {joint.name!r} mimics {name!r}, which is no moving joint; "
                    f"allowed are {', '.join(by_name)}."
                )
            if name in seen:
                raise ValueError(f"Joint {joint.name!r} mimics itself by {name!r}.")
            seen.add(name)
            offset += multiplier * float(mimic.offset)
            multiplier *= float(mimic.multiplier)
        own = joint.mimic is None
        resolved.append(None if own else (independent.index(name), multiplier, offset))
    return tuple(resolved)


def _choose_tool(walk: _Walk, end: _Place, tool: str | None) -> _Place:
    """Flange with the tool in it."""
    if tool is None and not walk.tools:
        return end
    if tool is None and len(walk.tools) == 1:
        (chosen,) = walk.tools.values()
        return chosen
    if tool is None or tool not in walk.tools:
        raise ValueError(
            "Argument `tool` must be one of the robot's tools "
            f"({', '.join(walk.tools) or 'there is none'}), but is {tool!r}."
        )
    return walk.tools[tool]


def _transform(rotation: np.ndarray, position: object) -> np.ndarray:
    """4 x 4 transform."""
    T = np.eye(4)
    T[:3, :3] = rotation
    T[:3, 3] = np.asarray(position, float)
    return T


def _rotation_of_z_to(axis: object) -> np.ndarray:
    """Smallest rotation that turns z to `axis`."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(np.asarray(axis, float))
    if z < -1.0 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    skew = np.array([[0.0, 0.0, x], [0.0, 0.0, y], [-x, -y, 0.0]])
    return np.eye(3) + skew + skew @ skew / (1.0 + z)


def _body_in_link(body: RigidBody, frame: np.ndarray) -> _Mass:
    """Body in its link's frame."""
    R = frame[:3, :3]
    center = R @ np.asarray(body.center_of_mass, float) + frame[:3, 3]
    inertia = R @ np.asarray(body.inertia, float) @ R.T
    return _Mass(float(body.mass), center, inertia)


def _merge(bodies: list[_Mass]) -> _Mass:
    """Several bodies as one."""
    mass = sum((body.mass for body in bodies), 0.0)
    # Rotors are described by an inertia without mass: any centre is as good.
    center = np.zeros(3)
    if mass > 0.0:
        center = np.sum([m * c for m, c, _ in bodies], axis=0) / mass
    inertia = np.zeros((3, 3))
    for m, c, about_own in bodies:
        arm = c - center
        inertia += about_own + m * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return _Mass(mass, center, inertia)


def _with_drive_options(robot: Robot, drives: Sequence[Drive | None]) -> Robot:
    """Robot with the options that its joints' elements ask for.

    Args:
        robot: The robot.
        drives: One per joint.

    Returns:
        The robot, the same if none asks for any.

    Raises:
        ValueError: If some of the motors have a mass, but not all of them, or a
            virtual joint has one.
    """
    if not any(drives):
        return robot
    filled = [drive or Drive() for drive in drives]
    column = lambda name: [float(getattr(drive, name)) for drive in filled]
    if any(column("backlash")):
        robot = robot.with_backlash(column("backlash"))
    coulomb, viscous = column("coulomb_friction"), column("viscous_friction")
    if any(coulomb + viscous):
        presliding = None
        if any(drive.presliding is not None for drive in filled):
            presliding = [drive.presliding or 0.0 for drive in filled]
        speed = column("friction_speed")
        robot = robot.with_friction(coulomb, viscous, speed, presliding=presliding)
    has_mass = [drive.motor_inertia is not None for drive in filled]
    if not any(has_mass):
        return robot
    if has_mass != robot.motor_mask().tolist():
        names = [n for n, m in zip(robot.joint_names, has_mass, strict=True) if m]
        raise ValueError(
            "Either all motors or none must have a `motor_inertia`, and virtual joints "
            f"have no motor, but those of {', '.join(names)} have one."
        )
    inertia = [drive.motor_inertia or 1.0 for drive in filled]
    stiffness = [drive.servo_stiffness or 1.0 for drive in filled]
    return robot.with_motors(inertia, stiffness, column("servo_damping"))
