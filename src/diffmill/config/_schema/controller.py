"""`[controller]`: what is between the program and the motors."""

import functools
import tomllib
from importlib import resources
from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import Float
from pydantic import Field

from ...settings.fields import (
    DampingRatio,
    Delay,
    Frequency,
    JointFrequency,
    JointRatio,
    PositiveTime,
)
from ...settings.tables import TomlTable, validated

if TYPE_CHECKING:
    from ...robot import Controller

# What stands for a part that a preset has and this controller lacks.
_NONE = "none"
# Nothing between program and motors.
_IDEAL = "ideal"


class ShaperTable(TomlTable):
    """`[controller] shaper`: the mode that an input shaper leaves at rest."""

    frequency: Frequency = Field(description='frequency of the mode, such as "9 Hz"')
    damping_ratio: DampingRatio = Field(
        default=0.0, description="damping ratio of the mode, below 1"
    )


class ControllerTable(TomlTable):
    """`[controller]`, after its preset.

    A key that is left out is that of `preset`: "ideal", the default, which has none,
    "kuka_krc4_like", "abb_irc5_like" or "cnc_following_error". The text "none" leaves
    out what the preset has.
    """

    interpolation_cycle: PositiveTime | None = Field(
        default=None, description='time between two set points, such as "12 ms"'
    )
    interpolation: Literal["hold", "linear", "spline"] = Field(
        default="spline",
        description="what the drives make of the set points: a staircase, a polygon or "
        "cubic pieces",
    )
    moving_average: PositiveTime | None = Field(
        default=None,
        description='time over which the command is averaged, such as "48 ms"',
    )
    shaper: ShaperTable | None = Field(
        default=None, description="mode that the command leaves at rest"
    )
    low_pass: Frequency | None = Field(
        default=None,
        description='cut-off frequency of a low-pass of first order, such as "20 Hz"',
    )
    dead_time: Delay | None = Field(
        default=None, description='time until a command acts at all, such as "15 ms"'
    )
    bandwidth: JointFrequency | None = Field(
        default=None, description='bandwidth of the servos, such as "10 Hz"'
    )
    damping_ratio: JointRatio | None = Field(
        default=None,
        description="damping ratio of servos of second order, such as 0.7; those "
        "without one are of first order",
    )

    def controller(self, joint_count: int, added: int) -> "Controller | None":
        """Controller of the table; None if it is ideal.

        Args:
            joint_count: Joints of the robot as its file has it.
            added: Virtual joints behind them, which have no motor.

        Raises:
            ValueError: A list has not one value for each joint.
        """
        from ...robot import Controller

        parts = {k: v for k, v in self if v is not None and k != "interpolation"}
        if not parts:
            return None
        if "damping_ratio" in parts and "bandwidth" not in parts:
            raise ValueError(
                "[controller] damping_ratio: found without a bandwidth, which is "
                "required beside it"
            )
        shaper = parts.pop("shaper", None)
        if shaper is not None:
            parts["shaper_frequency"] = shaper.frequency
            parts["shaper_damping_ratio"] = shaper.damping_ratio
        found = {}
        for key in ("bandwidth", "damping_ratio"):
            values = parts.get(key)
            if isinstance(values, list):
                if len(values) != joint_count:
                    raise ValueError(
                        f"[controller] {key}: found {len(values)} values, but one "
                        f"value, or one for each of the {joint_count} joints, is "
                        "required"
                    )
                found[key] = np.array(values)
        return Controller(
            interpolation=self.interpolation, **parts | _with_virtual(found, added)
        )


def _with_virtual(
    found: dict[str, Float[np.ndarray, " motor"]], added: int
) -> dict[str, Float[np.ndarray, " joint"]]:
    """Values of all joints, also of those without a motor.

    These do not move; they get values with which the mean lag of the servos, 1 / w or
    2 zeta / w, stays that of the motors.
    """
    late = 1 / found["bandwidth"] if "bandwidth" in found else np.ones(1)
    mean = {"bandwidth": 1 / late.mean()}
    if "damping_ratio" in found:
        mean["damping_ratio"] = np.mean(found["damping_ratio"] * late) / late.mean()
    return {key: np.append(x, np.full(added, mean[key])) for key, x in found.items()}


@functools.cache
def controller_presets() -> dict[str, dict[str, object]]:
    """Tables of the presets by their names, with the ideal one."""
    # Of the package itself, since its part `robot` imports JAX.
    file = resources.files("diffmill").joinpath("robot", "controllers.toml")
    return {_IDEAL: {}} | tomllib.loads(file.read_text(encoding="utf-8"))


def read_controller(raw: object, problems: list[str]) -> ControllerTable | None:
    """Checked table `[controller]`: its own keys count before those of its preset.

    Args:
        raw: What the file holds.
        problems: Receives a line for everything that is wrong.

    Returns:
        The table, or None if it has a fault.
    """
    if not isinstance(raw, dict):
        return validated(ControllerTable, raw, "[controller]", problems)
    name = raw.get("preset", _IDEAL)
    presets = controller_presets()
    if not isinstance(name, str) or name not in presets:
        problems.append(
            f"[controller] preset: found {name!r}; allowed: {', '.join(presets)}"
        )
        return None
    own = {key: value for key, value in raw.items() if key != "preset"}
    merged = {k: v for k, v in (presets[name] | own).items() if v != _NONE}
    table = validated(ControllerTable, merged, "[controller]", problems, ("preset",))
    # That of a preset goes with its cycle, which may have been taken out.
    is_stated = own.get("interpolation", _NONE) != _NONE
    if table is not None and is_stated and table.interpolation_cycle is None:
        problems.append(
            "[controller] interpolation: found without an interpolation_cycle, which "
            "is required beside it"
        )
        return None
    return table
