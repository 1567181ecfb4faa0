"""Unknowns of a kinematic calibration: names, places in `LinkErrors`, prior sizes."""

import dataclasses
from collections.abc import Iterator

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...robot import LinkErrors, Robot

# Where a tracker stands is not known at all [m, rad].
_ANYWHERE, _ANYHOW = 1.0, 1.0
# Fields of what is measured with, not of the arm.
PLACEMENT_FIELDS = (
    *("base_position", "base_rotation", "tool_position", "tool_rotation"),
    "fixed_point",
)
_WAVES = ("sin q", "cos q", "sin 2q", "cos 2q")


@dataclasses.dataclass(frozen=True)
class ErrorSizes:
    """Standard deviations that errors have before anything is measured.

    Attributes:
        displacement: Of a joint's frame along each axis [m].
        rotation: Of a joint's frame about each axis [rad].
        joint_offset: Of the zero of a turning joint [rad].
        slide_offset: Of the zero of a slide [m].
        tool: Of the tool's place in the flange, and of a fixed point, each axis [m].
        wave: Of each amplitude of a gear's waves [rad].
    """

    displacement: float = 2e-3
    rotation: float = 5e-3
    joint_offset: float = 20e-3
    slide_offset: float = 20e-3
    tool: float = 0.1
    wave: float = 0.5e-3


class ErrorParameter(eqx.Module):
    """An unknown.

    Attributes:
        name: In words, such as "axis_2 along z".
        field: Its field of `LinkErrors`, or "fixed_point".
        index: Its place there.
        size: Its standard deviation beforehand [m or rad].
        unit: "m" or "rad".
    """

    name: str = eqx.field(static=True)
    field: str = eqx.field(static=True)
    index: tuple[int, ...] = eqx.field(static=True)
    size: float = eqx.field(static=True)
    unit: str = eqx.field(static=True)

    @property
    def is_placement(self) -> bool:
        """True for what places instrument and tool, and is no error of the arm."""
        return self.field in PLACEMENT_FIELDS


def all_parameters(
    robot: Robot, sizes: ErrorSizes, observed: str, *, has_waves: bool
) -> tuple[ErrorParameter, ...]:
    """Unknowns of an arm under an instrument, those that place it first.

    A joint's own motion is its offset: no rotation about the axis of a turning joint,
    no displacement along a slide is there beside it.

    Args:
        robot: The robot.
        sizes: Their sizes beforehand.
        observed: "position", "frame" or "distance".
        has_waves: Whether gears may turn unevenly.
    """
    return tuple(
        [
            *_placement(sizes, observed),
            *_offsets(robot, sizes),
            *_frames(robot, sizes),
            *(_gears(robot, sizes) if has_waves else ()),
        ]
    )


def _placement(sizes: ErrorSizes, observed: str) -> Iterator[ErrorParameter]:
    """Unknowns of tool and instrument."""
    for i, axis in enumerate("xyz"):
        if observed == "distance":
            name = f"fixed point along {axis}"
            yield ErrorParameter(name, "fixed_point", (i,), sizes.tool, "m")
            continue
        name = f"base along {axis}"
        yield ErrorParameter(name, "base_position", (i,), _ANYWHERE, "m")
        name = f"base about {axis}"
        yield ErrorParameter(name, "base_rotation", (i,), _ANYHOW, "rad")
    for i, axis in enumerate("xyz"):
        yield ErrorParameter(
            f"tool along {axis}", "tool_position", (i,), sizes.tool, "m"
        )
        if observed == "frame":
            name = f"tool about {axis}"
            yield ErrorParameter(name, "tool_rotation", (i,), _ANYHOW, "rad")


def _offsets(robot: Robot, sizes: ErrorSizes) -> Iterator[ErrorParameter]:
    """Unknown zeros of the joints."""
    for j, (name, unit) in enumerate(
        zip(robot.joint_names, robot.joint_units, strict=True)
    ):
        size = sizes.slide_offset if unit == "m" else sizes.joint_offset
        yield ErrorParameter(f"offset of {name}", "joint_offsets", (j,), size, unit)


def _frames(robot: Robot, sizes: ErrorSizes) -> Iterator[ErrorParameter]:
    """Unknown displacements and rotations of the joints' frames."""
    for j, (name, kind) in enumerate(
        zip(robot.joint_names, robot.joint_kinds, strict=True)
    ):
        for field, word, size, unit, is_own in (
            ("displacement", "along", sizes.displacement, "m", kind == "prismatic"),
            ("rotation", "about", sizes.rotation, "rad", kind == "revolute"),
        ):
            for i, axis in enumerate("xy" if is_own else "xyz"):
                text = f"{name} {word} {axis}"
                yield ErrorParameter(text, field, (j, i), size, unit)


def _gears(robot: Robot, sizes: ErrorSizes) -> Iterator[ErrorParameter]:
    """Unknown waves of the gears of turning joints."""
    for j, (name, kind) in enumerate(
        zip(robot.joint_names, robot.joint_kinds, strict=True)
    ):
        for i, wave in enumerate(_WAVES if kind == "revolute" else ()):
            text = f"wave {wave} of {name}"
            yield ErrorParameter(text, "waves", (j, i), sizes.wave, "rad")


def link_errors(
    parameters: tuple[ErrorParameter, ...],
    x: Float[Array, " unknown"],
    robot: Robot,
    waves_per_turn: float,
) -> LinkErrors:
    """Errors of a robot for values of the unknowns.

    Args:
        parameters: The unknowns.
        x: Their values [m or rad], shape (unknown,).
        robot: The robot.
        waves_per_turn: Waves of a gear in a turn of its joint.
    """
    none = LinkErrors.none(robot)
    if any(one.field == "waves" for one in parameters):
        none = dataclasses.replace(
            none,
            waves=jnp.zeros((robot.joint_count, 4), robot.dtype),
            waves_per_turn=waves_per_turn,
        )
    values = {}
    for field in {one.field for one in parameters} - {"fixed_point"}:
        values[field] = placed(parameters, x, field, getattr(none, field))
    return dataclasses.replace(none, **values)


def placed(
    parameters: tuple[ErrorParameter, ...],
    x: Float[Array, " unknown"],
    field: str,
    zeros: Float[Array, "..."],
) -> Float[Array, "..."]:
    """Values of one field at their places.

    Args:
        parameters: The unknowns.
        x: Their values, shape (unknown,).
        field: The field.
        zeros: Its values without unknowns.
    """
    own = [i for i, one in enumerate(parameters) if one.field == field]
    if not own:
        return zeros
    index = tuple(np.array([parameters[i].index for i in own]).T)
    return zeros.at[index].add(x[np.array(own)])
