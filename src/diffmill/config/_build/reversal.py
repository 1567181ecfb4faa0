"""`[robot] reversal`: backlash and friction of the joints from a preset."""

import functools
import tomllib
from importlib import resources

import numpy as np

from ... import units as q
from ...robot import Robot
from .context import FileContext

_KINDS = {
    "backlash": q.ANGLE,
    "coulomb_friction": q.MOMENT,
    "viscous_friction": q.ROTARY_DAMPING,
    "presliding": q.ANGLE,
}
# Above it a run begins with the joint sliding [rad/s].
_FRICTION_SPEED = 1e-3


@functools.cache
def reversal_presets() -> dict[str, dict[str, list[str]]]:
    """Tables of the presets by their names."""
    file = resources.files("diffmill").joinpath("robot", "reversals.toml")
    return tomllib.loads(file.read_text(encoding="utf-8"))


def with_reversal(robot: Robot, name: str | None, context: FileContext) -> Robot:
    """Robot with the backlash and the friction of a preset, in place of its own.

    Args:
        robot: The robot with its drives.
        name: `reversal` of `[robot]`; None changes nothing.
        context: The job file.
    """
    if name is None:
        return robot
    presets = reversal_presets()
    if name not in presets:
        context.problems.append(
            f"[robot] reversal: found {name!r}; allowed: {', '.join(presets)}"
        )
        return robot
    values = {
        key: np.array([q.quantity(text, kind) for text in presets[name][key]])
        for key, kind in _KINDS.items()
    }
    count = len(values["backlash"])
    turning = [kind != "prismatic" for kind in robot.joint_kinds]
    if len(turning) != count or not all(turning):
        context.problems.append(
            f"[robot] reversal: found {name!r}, which is of {count} joints that turn, "
            f"beside a robot of {', '.join(robot.joint_names)}; a robot of that kind "
            "is required, or `drives` with a table [drive.JOINT] for each joint"
        )
        return robot
    if robot.backlash is not None or robot.friction is not None:
        context.notes.append(
            f"[robot] reversal: {name} replaces backlash and friction of the robot's "
            "own file and drives"
        )
    return robot.with_backlash(values["backlash"]).with_friction(
        values["coulomb_friction"],
        values["viscous_friction"],
        np.full(count, _FRICTION_SPEED),
        presliding=values["presliding"],
    )
