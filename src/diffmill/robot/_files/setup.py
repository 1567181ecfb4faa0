"""Setup of a robot beside its own file: springs, drives, spindle, tilt of the base.

It is read as a change of the robot's elements, so that a joint that is locked is none:
its bodies belong to the link before it.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from ... import units
from .._algebra.rotations import rpy_matrix
from .._model.elements import (
    AbstractElement,
    FixedRotation,
    FixedTranslation,
    Fork,
    PrismaticJoint,
    RevoluteJoint,
    RigidBody,
    Tool,
)
from .errors import raise_faults
from .table_reader import ElementReader
from .toml import JOINT_QUANTITIES, flatten, read_body, read_drive, read_options

_Joint: TypeAlias = RevoluteJoint | PrismaticJoint
# The body of a robot file that a spindle of the user's own replaces.
SPINDLE = "spindle"


class MountedElements(NamedTuple):
    """Elements of a robot, and the orientation of its base.

    Attributes:
        elements: From the base outwards.
        base: Rotation of the base in a world whose z points up, shape (3, 3).
    """

    elements: list[AbstractElement]
    base: Float[np.ndarray, "3 3"]


def apply_setup(
    document: Mapping[str, object],
    file: str,
    elements: Sequence[AbstractElement],
    tool: str | None,
) -> MountedElements:
    """Elements of a robot with the additions of a file.

    Args:
        document: The parsed file: tables `stiffness`, `damping`, `drive` and `locked`
            with joints' names as keys, table `spindle`, and `base_rpy`. Joints that
            are not there keep what they have.
        file: Name of the file, for messages.
        elements: The elements.
        tool: Name of the tool that the spindle carries; None for the only one.

    Raises:
        RobotFileError: If anything is wrong.
    """
    faults: list[str] = []
    top = ElementReader(document, "top level", faults)
    moving = [e for e in flatten(elements) if isinstance(e, _Joint)]
    joints = [joint for joint in moving if joint.mimic is None]
    locked = _read_locked(_table(top, "locked"), joints)
    free = [joint for joint in joints if joint.name not in locked]
    changes = _read_drives(top, free)
    spindle = None
    if SPINDLE in document:
        reader = _table(top, SPINDLE)
        before = len(faults)
        make = read_body(reader)
        reader.finish()
        spindle = make() if len(faults) == before else None
    rpy = top.quantities("base_rpy", units.ANGLE, (3,), (0.0, 0.0, 0.0))
    top.finish()
    raise_faults(file, faults)
    _lock_followers(locked, moving)
    elements = _changed(elements, changes, locked)
    if spindle is not None:
        has_tool = any(isinstance(element, Tool) for element in flatten(elements))
        elements = _at_tool(elements, spindle, tool)
        if not has_tool:
            elements.append(spindle)
    return MountedElements(elements, rpy_matrix(*(rpy or ())))


def _table(top: ElementReader, key: str) -> ElementReader:
    """Reader of a table, of an empty one without it or after a fault."""
    table = top.take(key, {})
    if not isinstance(table, Mapping):
        top.fault(key, "a table", table)
        table = {}
    return ElementReader(table, key, top.faults)


def _kind(joint: _Joint) -> str:
    return "prismatic" if isinstance(joint, PrismaticJoint) else "revolute"


def _read_drives(
    top: ElementReader, joints: Sequence[_Joint]
) -> dict[str, dict[str, object]]:
    """Changed fields of the joints, by the joint's name."""
    changes: dict[str, dict[str, object]] = {joint.name: {} for joint in joints}
    for key in ("stiffness", "damping"):
        reader = _table(top, key)
        for joint in joints:
            value = float(getattr(joint, key))
            changes[joint.name][key] = read_drive(
                reader, key, joint.name, _kind(joint), value
            )
        reader.finish()
    reader = _table(top, "drive")
    for joint in joints:
        drive = read_options(reader, joint.name, _kind(joint))
        if drive is not None:
            changes[joint.name]["drive"] = drive
    reader.finish()
    return changes


def _read_locked(reader: ElementReader, joints: Sequence[_Joint]) -> dict[str, float]:
    """Positions of the locked joints, by name [rad or m]."""
    locked = {}
    for joint in joints:
        kind = JOINT_QUANTITIES[_kind(joint)]["position"]
        lower, upper = float(joint.lower), float(joint.upper)
        value = reader.quantity(
            joint.name,
            kind,
            is_allowed=lambda x, low=lower, high=upper: low <= x <= high,
            allowed=f"within the joint's limits, {lower:g} to {upper:g} in SI units",
        )
        if joint.name in reader.table:
            locked[joint.name] = value
    reader.finish()
    return locked


def _lock_followers(locked: dict[str, float], joints: Sequence[_Joint]) -> None:
    """Lock the joints that follow a locked one, and those that follow these."""
    waiting = [joint for joint in joints if joint.mimic is not None]
    while True:
        ready = [j for j in waiting if j.mimic is not None and j.mimic.joint in locked]
        if not ready:
            return
        for joint in ready:
            mimic = joint.mimic
            assert mimic is not None
            at = locked[mimic.joint]
            locked[joint.name] = float(mimic.multiplier) * at + float(mimic.offset)
        waiting = [joint for joint in waiting if joint.name not in locked]


def _changed(
    elements: Sequence[AbstractElement],
    changes: Mapping[str, Mapping[str, object]],
    locked: Mapping[str, float],
) -> list[AbstractElement]:
    """Elements with joints changed, and locked ones fixed."""
    result: list[AbstractElement] = []
    for element in elements:
        if isinstance(element, Fork):
            branches = [_changed(b, changes, locked) for b in element.branches]
            result.append(Fork(branches))
        elif isinstance(element, _Joint) and element.name in locked:
            result.append(_locked_joint(element, locked[element.name]))
        elif isinstance(element, _Joint) and element.mimic is None:
            result.append(dataclasses.replace(element, **changes[element.name]))
        else:
            result.append(element)
    return result


def _locked_joint(joint: _Joint, position: float) -> AbstractElement:
    """Fixed element in place of a joint that is locked at a position [rad or m]."""
    axis = np.asarray(joint.axis, float)
    x, y, z = axis / np.linalg.norm(axis)
    if isinstance(joint, PrismaticJoint):
        return FixedTranslation((position * x, position * y, position * z))
    # Rodrigues' formula.
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turn = np.sin(position) * skew + (1.0 - np.cos(position)) * skew @ skew
    return FixedRotation(np.eye(3) + turn)


def _at_tool(
    elements: Sequence[AbstractElement], spindle: RigidBody, tool: str | None
) -> list[AbstractElement]:
    """Elements with a spindle before the tool, if there is one, and no other."""
    result: list[AbstractElement] = []
    for element in elements:
        if isinstance(element, Fork):
            result.append(Fork([_at_tool(b, spindle, tool) for b in element.branches]))
        elif isinstance(element, Tool) and tool in (None, element.name):
            result += [spindle, element]
        elif not (isinstance(element, RigidBody) and element.name == SPINDLE):
            result.append(element)
    return result
