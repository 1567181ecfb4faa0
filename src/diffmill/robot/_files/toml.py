"""Robot files in TOML, from parsed tables to elements.

All faults of a file are collected and reported together.
"""

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ... import units
from .._algebra.rotations import rpy_matrix
from .._model.elements import (
    AbstractElement,
    Drive,
    FixedRotation,
    FixedTranslation,
    Fork,
    Mimic,
    PrismaticJoint,
    RevoluteJoint,
    RigidBody,
    RobotDescription,
    Tool,
    inertia_fault,
    is_direction,
    triangle_fault,
)
from .errors import raise_faults
from .table_reader import ElementReader, are_numbers, is_list

JOINT_QUANTITIES = {
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


def read_elements(document: Mapping[str, object], file: str) -> RobotDescription:
    """Robot of a parsed file.

    Args:
        document: The parsed file.
        file: Name of the file, for messages.

    Raises:
        RobotFileError: If anything is wrong.
    """
    faults: list[str] = []
    top = ElementReader(document, "top level", faults)
    name = top.text("name")
    top.text("description", "")
    elements = _read_list(top.take("elements", required=True), "elements", faults)
    top.finish()
    moving = [
        e for e in flatten(elements) if isinstance(e, RevoluteJoint | PrismaticJoint)
    ]
    joints = [joint.name for joint in moving]
    for joint in moving:
        if joint.mimic is not None and joint.mimic.joint not in joints:
            faults.append(
                f"elements: {joint.name!r} is coupled with {joint.mimic.joint!r}, "
                "which is no joint"
            )
    for twice in sorted({n for n in joints if joints.count(n) > 1}):
        faults.append(f"elements: the joint name {twice!r} occurs more than once")
    if not joints and not faults:
        faults.append("elements: must contain at least one joint")
    raise_faults(file, faults)
    return RobotDescription(name, elements)


def _read_list(raw: object, place: str, faults: list[str]) -> list[AbstractElement]:
    """Elements of a list of tables."""
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
        reader = ElementReader(table, f"{where} ({kind})", faults)
        before = len(faults)
        make = _READERS[kind](reader)
        reader.finish()
        if len(faults) == before:
            made = make()
            elements.extend([made] if isinstance(made, AbstractElement) else made)
    return elements


def _read_translation(reader: ElementReader) -> Callable[[], AbstractElement]:
    position = reader.quantities("position", units.LENGTH, (3,))
    return lambda: FixedTranslation(tuple(position or ()))


def _read_rotation(reader: ElementReader) -> Callable[[], AbstractElement]:
    rpy = reader.quantities("rpy", units.ANGLE, (3,))
    return lambda: FixedRotation(rpy_matrix(*(rpy or ())))


def _read_dh(reader: ElementReader) -> Callable[[], list[AbstractElement]]:
    """Fixed part of a row of Denavit and Hartenberg's."""
    theta = reader.quantity("theta", units.ANGLE, 0.0)
    alpha = reader.quantity("alpha", units.ANGLE, 0.0)
    d = reader.quantity("d", units.LENGTH, 0.0)
    a = reader.quantity("a", units.LENGTH, 0.0)
    convention = reader.take("convention", "standard")
    if convention not in _CONVENTIONS:
        reader.fault("convention", " or ".join(_CONVENTIONS), convention)
    along_z = [
        FixedRotation(rpy_matrix(0.0, 0.0, theta)),
        FixedTranslation((0.0, 0.0, d)),
    ]
    along_x = [
        FixedTranslation((a, 0.0, 0.0)),
        FixedRotation(rpy_matrix(alpha, 0.0, 0.0)),
    ]
    if convention == "standard":
        return lambda: [*along_z, *along_x]
    return lambda: [*along_x[::-1], *along_z]


def _read_coupling(
    reader: ElementReader, kind: str, axis: tuple[float, ...]
) -> list[AbstractElement]:
    """Coupling that turns a joint with another one; nothing without `coupled`."""
    inner = reader.inner("coupled", "a table of joint and ratio")
    if inner is None:
        return []
    other = inner.text("joint", allowed="the name of a joint", may_be_empty=False)
    name = reader.table.get("name")
    if other == name:
        inner.fault("joint", "the name of another joint", other)
    ratio = [inner.take("ratio", 1.0)]
    if not are_numbers(ratio):
        inner.fault("ratio", "a number", ratio[0])
        ratio = [1.0]
    inner.finish()
    joint = RevoluteJoint if kind == "revolute" else PrismaticJoint
    return [joint(f"coupling of {name}", axis, mimic=Mimic(other, ratio[0]))]


def _read_joint(reader: ElementReader) -> Callable[[], list[AbstractElement]]:
    kind = str(reader.table["kind"])
    position = JOINT_QUANTITIES[kind]["position"]
    name = reader.text("name", allowed="a non-empty string", may_be_empty=False)
    axis, raw = (0.0, 0.0, 1.0), reader.take("axis", (0.0, 0.0, 1.0))
    if is_list(raw) and len(raw) == 3 and are_numbers(raw) and is_direction(raw):
        axis = tuple(map(float, raw))
    else:
        reader.fault("axis", "a list of 3 numbers that are not all 0", raw)
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
        JOINT_QUANTITIES[kind]["speed"],
        math.inf,
        is_allowed=lambda x: x > 0,
        allowed="positive",
    )
    K = read_drive(reader, "stiffness", "stiffness", kind, math.inf)
    D = read_drive(reader, "damping", "damping", kind, 0.0)
    drive = read_options(reader, "drive", kind)
    coupling = _read_coupling(reader, kind, axis)
    joint = RevoluteJoint if kind == "revolute" else PrismaticJoint
    return lambda: [
        *coupling,
        joint(
            name=name,
            axis=axis,
            stiffness=K,
            damping=D,
            lower=lower,
            upper=upper,
            home=home,
            is_virtual=is_virtual is True,
            drive=drive,
            speed=speed,
        ),
    ]


# The fixed part of a row follows its joint, or precedes it.
_CONVENTIONS = ("standard", "modified")

# Keys of a joint's table `drive`: their quantity, and True if they must be above 0.
_OPTIONS = {
    "backlash": ("position", False),
    "coulomb_friction": ("force", False),
    "viscous_friction": ("damping", False),
    "friction_speed": ("speed", True),
    "presliding": ("position", True),
    "motor_inertia": ("inertia", True),
    "servo_stiffness": ("stiffness", True),
    "servo_damping": ("damping", False),
}


def read_options(reader: ElementReader, key: str, kind: str) -> Drive | None:
    """Options of a joint's drive, None without a table or after a fault."""
    inner = reader.inner(key, f"a table of {', '.join(_OPTIONS)}")
    if inner is None:
        return None
    table = inner.table
    before = len(inner.faults)
    values = {
        key: inner.quantity(
            key,
            JOINT_QUANTITIES[kind][unit],
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


def read_drive(
    reader: ElementReader, quantity: str, key: str, kind: str, default: float
) -> float:
    """Stiffness (positive) or damping (not negative) of a joint in SI."""
    is_stiffness = quantity == "stiffness"
    return reader.quantity(
        key,
        JOINT_QUANTITIES[kind][quantity],
        default,
        is_allowed=lambda x: x > 0 or (x == 0 and not is_stiffness),
        allowed="positive" if is_stiffness else "not negative",
    )


def read_body(reader: ElementReader) -> Callable[[], RigidBody]:
    """Constructor of the body of a table, to be called once that has no fault."""
    name = reader.text("name", "")
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
    return lambda: RigidBody(mass, tuple(center or ()), inertia, name=name)


def _read_fork(reader: ElementReader) -> Callable[[], AbstractElement]:
    raw = reader.take("branches", required=True)
    branches = []
    if raw is not None and not is_list(raw):
        reader.fault("branches", "a list of lists of elements", raw)
    elif raw is not None:
        for index, branch in enumerate(raw):
            place = f"{reader.place}.branches[{index}]"
            branches.append(_read_list(branch, place, reader.faults))
    return lambda: Fork(branches)


def _read_tool(reader: ElementReader) -> Callable[[], AbstractElement]:
    name = reader.text("name", "tool", allowed="a non-empty string", may_be_empty=False)
    position = reader.quantities("position", units.LENGTH, (3,), (0.0, 0.0, 0.0))
    rpy = reader.quantities("rpy", units.ANGLE, (3,), (0.0, 0.0, 0.0))
    return lambda: Tool(name, tuple(position or ()), rpy_matrix(*(rpy or ())))


_READERS: dict[
    str,
    Callable[[ElementReader], Callable[[], AbstractElement | list[AbstractElement]]],
] = {
    "translation": _read_translation,
    "rotation": _read_rotation,
    "revolute": _read_joint,
    "prismatic": _read_joint,
    "body": read_body,
    "fork": _read_fork,
    "tool": _read_tool,
    "dh": _read_dh,
}


def flatten(elements: Sequence[AbstractElement]) -> list[AbstractElement]:
    """All elements, those of branches too."""
    flat: list[AbstractElement] = []
    for element in elements:
        flat.append(element)
        if isinstance(element, Fork):
            for branch in element.branches:
                flat.extend(flatten(branch))
    return flat
