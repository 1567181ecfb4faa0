"""What a robot file may contain, from parsed tables to elements.

All faults of a file are collected and reported together.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from .. import units
from ._elements import (
    AbstractElement,
    Drive,
    FixedRotation,
    FixedTranslation,
    Fork,
    PrismaticJoint,
    RevoluteJoint,
    RigidBody,
    Tool,
    inertia_fault,
    triangle_fault,
)
from ._faults import raise_faults
from ._reader import TableReader, are_numbers, is_list
from ._robot import Robot
from ._rotations import rpy_matrix

_JOINT_QUANTITIES = {
    "revolute": {
        "position": units.ANGLE,
        "stiffness": units.ROTARY_STIFFNESS,
        "damping": units.ROTARY_DAMPING,
        "force": units.MOMENT,
        "speed": units.ANGULAR_SPEED,
        "inertia": units.INERTIA,
    },
    "prismatic": {
        "position": units.LENGTH,
        "stiffness": units.LINEAR_STIFFNESS,
        "damping": units.LINEAR_DAMPING,
        "force": units.FORCE,
        "speed": units.SPEED,
        "inertia": units.MASS,
    },
}


def read_elements(
    document: Mapping[str, object], file: str
) -> tuple[str, list[AbstractElement]]:
    """Return the name and the elements of a parsed robot file.

    Args:
        document: The parsed file.
        file: Name of the file, for messages.

    Returns:
        The model's name, its elements.

    Raises:
        RobotFileError: If anything is wrong.
    """
    faults: list[str] = []
    top = TableReader(document, "top level", faults)
    name = top.take("name", required=True)
    if not isinstance(name, str) and "name" in document:
        top.fault("name", "a string", name)
    if not isinstance(top.take("description", ""), str):
        top.fault("description", "a string", document["description"])
    elements = _read_list(top.take("elements", required=True), "elements", faults)
    top.finish()
    joints = [
        e.name
        for e in _flatten(elements)
        if isinstance(e, RevoluteJoint | PrismaticJoint)
    ]
    for twice in sorted({n for n in joints if joints.count(n) > 1}):
        faults.append(f"elements: the joint name {twice!r} occurs more than once")
    if not joints and not faults:
        faults.append("elements: must contain at least one joint")
    raise_faults(file, faults)
    return str(name), elements


def read_drives(
    document: Mapping[str, object], file: str, robot: Robot
) -> tuple[list[float], list[float]]:
    """Return stiffness and damping of a robot's joints from a parsed file.

    Args:
        document: The parsed file: tables `stiffness` and `damping`, with joints' names
            as keys. Joints that are not there keep what the robot has.
        file: Name of the file, for messages.
        robot: The robot.

    Returns:
        K [N m/rad or N/m] and D [N m s/rad or N s/m], one per joint.

    Raises:
        RobotFileError: If anything is wrong.
    """
    faults: list[str] = []
    top = TableReader(document, "top level", faults)
    columns = []
    for key, present in (
        ("stiffness", robot.joint_stiffness),
        ("damping", robot.joint_damping),
    ):
        table = top.take(key, {})
        if not isinstance(table, Mapping):
            top.fault(key, "a table with joints' names as keys", table)
            continue
        reader = TableReader(table, key, faults)
        rows = zip(robot.joint_names, robot.joint_kinds, present.tolist(), strict=True)
        columns.append(
            [_read_drive(reader, key, name, kind, value) for name, kind, value in rows]
        )
        reader.finish()
    top.finish()
    raise_faults(file, faults)
    stiffness, damping = columns
    return stiffness, damping


def _read_list(raw: Any, place: str, faults: list[str]) -> list[AbstractElement]:
    """Return the elements of a list of tables."""
    if raw is None:
        return []
    if not is_list(raw):
        faults.append(f"{place}: must be a list of tables, but is {raw!r}")
        return []
    elements = []
    for index, table in enumerate(raw):
        where = f"{place}[{index}]"
        if not isinstance(table, Mapping):
            faults.append(f"{where}: must be a table, but is {table!r}")
            continue
        kind = table.get("kind")
        if not isinstance(kind, str) or kind not in _READERS:
            faults.append(
                f"{where}.kind: must be one of {', '.join(_READERS)}, but is {kind!r}"
            )
            continue
        reader = TableReader(table, f"{where} ({kind})", faults)
        before = len(faults)
        make = _READERS[kind](reader)
        reader.finish()
        if len(faults) == before:
            elements.append(make())
    return elements


def _read_translation(reader: TableReader) -> Callable[[], AbstractElement]:
    position = reader.quantities("position", units.LENGTH, (3,))
    return lambda: FixedTranslation(tuple(position or ()))


def _read_rotation(reader: TableReader) -> Callable[[], AbstractElement]:
    rpy = reader.quantities("rpy", units.ANGLE, (3,))
    return lambda: FixedRotation(rpy_matrix(*(rpy or ())))


def _read_joint(reader: TableReader) -> Callable[[], AbstractElement]:
    kind = str(reader.table["kind"])
    position = _JOINT_QUANTITIES[kind]["position"]
    name = reader.take("name", required=True)
    if "name" in reader.table and not (isinstance(name, str) and name):
        reader.fault("name", "a non-empty string", name)
    axis = reader.take("axis", (0.0, 0.0, 1.0))
    if not (is_list(axis) and len(axis) == 3 and are_numbers(axis) and any(axis)):
        reader.fault("axis", "a list of 3 numbers that are not all 0", axis)
    is_virtual = reader.take("virtual", False)
    if not isinstance(is_virtual, bool):
        reader.fault("virtual", "true or false", is_virtual)
    lower = reader.quantity("lower", position, -math.inf)
    upper = reader.quantity("upper", position, math.inf)
    home = reader.quantity("home", position, 0.0)
    if not lower <= home <= upper:
        reader.fault("home", f"between lower {lower:g} and upper {upper:g}", home)
    speed = reader.quantity(
        "speed",
        _JOINT_QUANTITIES[kind]["speed"],
        math.inf,
        is_allowed=lambda x: x > 0,
        allowed="positive",
    )
    K = _read_drive(reader, "stiffness", "stiffness", kind, math.inf)
    D = _read_drive(reader, "damping", "damping", kind, 0.0)
    drive = _read_options(reader, kind)
    joint = RevoluteJoint if kind == "revolute" else PrismaticJoint
    return lambda: joint(
        name=name,
        axis=tuple(map(float, axis)),
        stiffness=K,
        damping=D,
        lower=lower,
        upper=upper,
        home=home,
        is_virtual=is_virtual,
        drive=drive,
        speed=speed,
    )


# What a joint's table `drive` may hold, and whether it must be above 0.
_OPTIONS = {
    "backlash": ("position", False),
    "coulomb_friction": ("force", False),
    "viscous_friction": ("damping", False),
    "friction_speed": ("speed", True),
    "motor_inertia": ("inertia", True),
    "servo_stiffness": ("stiffness", True),
    "servo_damping": ("damping", False),
}


def _read_options(reader: TableReader, kind: str) -> Drive | None:
    """Return what a joint's table `drive` says, None without one or after a fault."""
    table = reader.take("drive")
    if table is None:
        return None
    if not isinstance(table, Mapping):
        reader.fault("drive", f"a table of {', '.join(_OPTIONS)}", table)
        return None
    inner = TableReader(table, f"{reader.place}.drive", reader.faults)
    before = len(inner.faults)
    values = {
        key: inner.quantity(
            key,
            _JOINT_QUANTITIES[kind][unit],
            is_allowed=lambda x, low=is_open: x > 0 or (x == 0 and not low),
            allowed="positive" if is_open else "not negative",
        )
        for key, (unit, is_open) in _OPTIONS.items()
    }
    if ("motor_inertia" in table) != ("servo_stiffness" in table):
        inner.fault("motor_inertia", "given beside servo_stiffness", dict(table))
    inner.finish()
    if len(inner.faults) > before:
        return None
    return Drive(**{key: values[key] for key in _OPTIONS if key in table})


def _read_drive(
    reader: TableReader, quantity: str, key: str, kind: str, default: float
) -> float:
    """Return a joint's stiffness (positive) or damping (not negative) in SI."""
    is_stiffness = quantity == "stiffness"
    return reader.quantity(
        key,
        _JOINT_QUANTITIES[kind][quantity],
        default,
        is_allowed=lambda x: x > 0 or (x == 0 and not is_stiffness),
        allowed="positive" if is_stiffness else "not negative",
    )


def _read_body(reader: TableReader) -> Callable[[], AbstractElement]:
    mass = reader.quantity(
        "mass",
        units.MASS,
        required=True,
        is_allowed=lambda x: x > 0,
        allowed="positive",
    )
    center = reader.quantities("center_of_mass", units.LENGTH, (3,), (0.0, 0.0, 0.0))
    moments = reader.quantities("inertia", units.INERTIA, (3, 6))
    inertia = np.eye(3)
    if moments is not None:
        xx, yy, zz, xy, xz, yz = [*moments, 0.0, 0.0, 0.0][:6]
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        wrong = inertia_fault(inertia) or triangle_fault(inertia)
        if wrong:
            reader.faults.append(
                f"{reader.place}.inertia: (xx, yy, zz, xy, xz, yz) must be {wrong}"
            )
    return lambda: RigidBody(mass, tuple(center or ()), inertia)


def _read_fork(reader: TableReader) -> Callable[[], AbstractElement]:
    raw = reader.take("branches", required=True)
    branches = []
    if raw is not None and not is_list(raw):
        reader.fault("branches", "a list of lists of elements", raw)
    elif raw is not None:
        for index, branch in enumerate(raw):
            place = f"{reader.place}.branches[{index}]"
            branches.append(_read_list(branch, place, reader.faults))
    return lambda: Fork(branches)


def _read_tool(reader: TableReader) -> Callable[[], AbstractElement]:
    name = reader.take("name", "tool")
    if not (isinstance(name, str) and name):
        reader.fault("name", "a non-empty string", name)
    position = reader.quantities("position", units.LENGTH, (3,), (0.0, 0.0, 0.0))
    rpy = reader.quantities("rpy", units.ANGLE, (3,), (0.0, 0.0, 0.0))
    return lambda: Tool(name, tuple(position or ()), rpy_matrix(*(rpy or ())))


_READERS: dict[str, Callable[[TableReader], Callable[[], AbstractElement]]] = {
    "translation": _read_translation,
    "rotation": _read_rotation,
    "revolute": _read_joint,
    "prismatic": _read_joint,
    "body": _read_body,
    "fork": _read_fork,
    "tool": _read_tool,
}


def _flatten(elements: Sequence[AbstractElement]) -> list[AbstractElement]:
    """Return all elements, those of branches too."""
    flat: list[AbstractElement] = []
    for element in elements:
        flat.append(element)
        if isinstance(element, Fork):
            for branch in element.branches:
                flat.extend(_flatten(branch))
    return flat
