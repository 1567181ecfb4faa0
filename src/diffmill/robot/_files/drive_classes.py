"""Stiffness and damping of drives by the payload class of an arm, as published."""

import functools
import tomllib
from importlib import resources
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ... import units
from .._model.robot import Robot


class DriveClass(NamedTuple):
    """Drives of the arms of a payload class, as one of them was measured.

    Attributes:
        name: Name, such as "class 200 kg".
        stiffness: Of each joint [N m/rad], shape (joint,).
        damping: Of each joint [N m s/rad], shape (joint,).
        spread: Relative standard deviation of the stiffness on another arm.
        damping_spread: The same of the damping.
        source: Source of the numbers.
    """

    name: str
    stiffness: Float[np.ndarray, " joint"]
    damping: Float[np.ndarray, " joint"]
    spread: float
    damping_spread: float
    source: str

    def applied_to(self, robot: Robot) -> Robot:
        """Robot whose joints have these springs and dampers.

        Args:
            robot: A robot whose joints have none.

        Raises:
            ValueError: It is no arm of so many joints that turn, or it has springs.
        """
        kinds = robot.joint_kinds
        if len(kinds) != len(self.stiffness) or "prismatic" in kinds:
            raise ValueError(
                f"{self.name} has drives for {len(self.stiffness)} joints that turn, "
                f"but the robot has {', '.join(robot.joint_names)}"
            )
        soft = np.isfinite(np.asarray(robot.joint_stiffness))
        if soft.any():
            names = [n for n, s in zip(robot.joint_names, soft, strict=True) if s]
            raise ValueError(
                f"{self.name} is for a robot without springs, but the joints "
                f"{', '.join(names)} have one of their own"
            )
        return robot.with_drives(stiffness=self.stiffness, damping=self.damping)

    def note(self) -> str:
        """Sentence that says what is assumed."""
        return (
            f"stiffness and damping are assumed, those of {self.name}: {self.source}. "
            f"On another arm of the class the stiffness of a joint differs by "
            f"{self.spread:.0%} and its damping by {self.damping_spread:.0%} (standard "
            "deviations, assumed): load tests give those of yours"
        )


@functools.cache
def drive_classes() -> dict[str, DriveClass]:
    """Classes of drives by name, such as "class 200 kg"."""
    file = resources.files("diffmill").joinpath("robot", "drives.toml")
    classes = {}
    for name, table in tomllib.loads(file.read_text(encoding="utf-8")).items():
        stiffness = np.array(
            [
                units.quantity(text, units.ROTARY_STIFFNESS)
                for text in table["stiffness"]
            ]
        )
        time = units.quantity(table["damping_time"], units.TIME)
        classes[name] = DriveClass(
            name,
            stiffness,
            time * stiffness,
            table["spread"],
            table["damping_spread"],
            table["source"],
        )
    return classes
