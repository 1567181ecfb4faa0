"""Joint positions as text with units, such as "0 deg, -90 deg, 250 mm"."""

import numpy as np
from jaxtyping import Float

from .. import units as q
from ..robot import Robot

_KINDS = {"revolute": q.ANGLE, "prismatic": q.LENGTH}


def parse_pose(text: str, robot: Robot) -> Float[np.ndarray, " joint"]:
    """Return the joint positions that a text with units names.

    Args:
        text: One quantity per joint, separated by commas; those of virtual joints may
            be left out, and are then 0.
        robot: The robot.

    Returns:
        Joint positions [rad or m], shape (joint,).

    Raises:
        ValueError: If the count, a quantity or its unit is wrong, or a position is
            beyond the joint's limits; the message names all that is wrong.
    """
    parts = [part.strip() for part in text.split(",")]
    joints = range(robot.joint_count)
    if len(parts) == len(robot.motor_joints):
        joints = robot.motor_joints
    names = [robot.joint_names[k] for k in joints]
    if len(parts) != len(names):
        raise ValueError(
            f"found {len(parts)} positions, but one per joint is required: "
            f"{', '.join(names)}"
        )
    positions, faults = np.zeros(robot.joint_count), []
    for k, part in zip(joints, parts, strict=True):
        name, kind = robot.joint_names[k], robot.joint_kinds[k]
        try:
            positions[k] = q.quantity(part, _KINDS[kind])
        except ValueError as error:
            faults.append(f"{name}: {error}")
            continue
        lower, upper = float(robot.joint_lower[k]), float(robot.joint_upper[k])
        if not lower - 1e-9 <= positions[k] <= upper + 1e-9:
            # Degrees and millimetres: the units in which limits are known.
            scale, unit = (1e3, "mm") if kind == "prismatic" else (180 / np.pi, "deg")
            faults.append(
                f"{name}: found {part}; allowed is {lower * scale:g} to "
                f"{upper * scale:g} {unit}"
            )
    if faults:
        raise ValueError("; ".join(faults))
    return positions
