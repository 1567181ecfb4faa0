"""The table `[correction]` of a job file, and what of it depends on the rest."""

import math
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BeforeValidator, Field, StrictBool, StrictInt

from .fields import (
    Acceleration,
    Delay,
    PositiveLength,
    PositiveSpeed,
    PositiveTime,
    Tolerance,
    Uncertainty,
)
from .table import TomlTable

if TYPE_CHECKING:
    from ..._job import CorrectionSettings
    from ...cutter import AbstractCutter


def _weight(value: object) -> float:
    """Return a weight, a number of at least 0."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        if 0 <= value < math.inf:
            return float(value)
    raise ValueError(f"found {value!r}, but a number of at least 0 is required")


def _rows(value: object) -> int | str:
    """Return a number of rows, or "auto"."""
    if value == "auto":
        return "auto"
    if isinstance(value, int) and not isinstance(value, bool) and value > 0:
        return value
    raise ValueError(
        f'found {value!r}, but "auto" or a number of tooth periods above 0 is required'
    )


def _factor(value: object) -> float:
    """Return a factor, a number of at least 1 or inf."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        if value >= 1:
            return float(value)
    raise ValueError(
        f"found {value!r}, but a number of at least 1, or inf, is required"
    )


Rows = Annotated[int | Literal["auto"], BeforeValidator(_rows)]
Weight = Annotated[float, BeforeValidator(_weight)]
Factor = Annotated[float, BeforeValidator(_factor)]


# Steps of Adam unless a job says otherwise.
_ADAM_STEPS = 60
# What a corrected command may accelerate unless a job says otherwise, over the program.
_FACTOR = 2.0


class WeightTable(TomlTable):
    """One entry of `weight`: a section of the program and how much it counts."""

    lines: Annotated[list[StrictInt], Field(min_length=2, max_length=2)] = Field(
        description="first and last line of the program, such as [120, 180]"
    )
    value: Weight = Field(description="a number of at least 0")


class UncertaintyTable(TomlTable):
    """`[correction.uncertainty]`: how well the model is known, mostly relative."""

    stiffness: Uncertainty = 0.0
    damping: Uncertainty = 0.0
    force: Uncertainty = 0.0
    gaussian: StrictBool = False
    draws: Annotated[StrictInt, Field(ge=1, le=100)] = 4
    seed: Annotated[StrictInt, Field(ge=0, le=2**31 - 1)] = 0
    objective: Literal["mean", "worst"] = "mean"
    delay: Delay = 0.0


class CorrectionTable(TomlTable):
    """`[correction]`."""

    objective: Literal["path", "surface"] = "path"
    method: Literal[
        "gauss_newton",
        "adam",
        "mirror",
        "mirror_iterated",
        "input_shaper",
        "inverse_drive",
    ] = "gauss_newton"
    compare: Literal["few", "all"] = "few"
    command: Literal["tip", "joint"] = "tip"
    tolerance: Tolerance = 0.0
    tolerance_band: PositiveLength | None = None
    weight: list[WeightTable] = Field(default_factory=list)
    finishing_only: StrictBool = False
    wall_weight: Weight = 1.0
    floor_weight: Weight = 1.0
    knot_spacing: PositiveTime = 30e-3
    max_offset: PositiveLength = 1e-3
    max_velocity: PositiveSpeed | None = None
    max_acceleration: Acceleration | None = None
    acceleration_factor: Factor | None = None
    gouge: PositiveLength | None = None
    stay_in_cut: StrictBool = False
    uncertainty: UncertaintyTable | None = None
    max_steps: Annotated[StrictInt, Field(ge=1, le=1000)] | None = None
    start_spread: Tolerance = 0.0
    start_seed: Annotated[StrictInt, Field(ge=0, le=2**31 - 1)] = 0
    horizon: Rows = "auto"
    overlap: Rows = "auto"


def correction_settings(
    table: CorrectionTable, *, is_recorded: bool
) -> "CorrectionSettings":
    """Return the settings of a checked table.

    Args:
        table: The table.
        is_recorded: Whether the path is a recorded one. It need not start from rest
            and may hardly accelerate at all, so that a factor of it says nothing.
    """
    from ..._job import CorrectionSettings, LineWeight, UncertaintySettings

    values: dict[str, Any] = table.model_dump(
        exclude={"weight", "uncertainty"}, exclude_none=True
    )
    # Who says which error does not count has said which one is allowed.
    values.setdefault("tolerance_band", table.tolerance)
    if table.method == "adam":
        values.setdefault("max_steps", _ADAM_STEPS)
    is_bound = table.max_acceleration is not None
    if _holds_limits(table) and not is_recorded and not is_bound:
        values.setdefault("acceleration_factor", _FACTOR)
    if (known := table.uncertainty) is not None:
        values["uncertainty"] = UncertaintySettings(
            stiffness=known.stiffness,
            damping=known.damping,
            force=known.force,
            is_gaussian=known.gaussian,
            draws=known.draws,
            seed=known.seed,
            objective=known.objective,
            delay=known.delay,
        )
    sections = tuple(LineWeight(e.lines[0], e.lines[1], e.value) for e in table.weight)
    return CorrectionSettings(**values, sections=sections)


def check_correction(
    table: CorrectionTable,
    cutter: "AbstractCutter",
    is_upright: bool,
    problems: list[str],
) -> None:
    """Note settings that the cutter, the path or each other do not allow."""
    _check_segments(table, problems)
    for key, found, is_asked, allowed in (
        ("objective", '"surface"', table.objective == "surface", '"path"'),
        ("gouge", "a limit", table.gouge is not None, "none"),
        ("stay_in_cut", "true", table.stay_in_cut, "false"),
    ):
        if is_asked and not (cutter.is_plain and is_upright):
            problems.append(
                f"[correction] {key}: found {found}, which needs a flat cutter that "
                f"stands along +z; allowed here: {allowed}"
            )
    if table.objective == "surface":
        if table.wall_weight == table.floor_weight == 0:
            problems.append(
                "[correction] wall_weight: found 0 beside floor_weight = 0, but one of "
                "them above 0 is required"
            )
    _check_method(table, problems)
    for entry in table.weight:
        first, last = entry.lines
        if not 1 <= first <= last:
            problems.append(
                f"[correction] weight.lines: found [{first}, {last}], but two line "
                "numbers from 1, the first not above the last, are required"
            )


def _check_segments(table: CorrectionTable, problems: list[str]) -> None:
    """Note a horizon beside what needs the whole path, or too short for its overlap."""
    for beside, is_whole in (
        ('objective = "surface"', table.objective == "surface"),
        ("an uncertainty", table.uncertainty is not None),
        ('method = "adam"', table.method == "adam"),
    ):
        if table.horizon != "auto" and is_whole:
            problems.append(
                f"[correction] horizon: found {table.horizon} beside {beside}, which "
                'needs the whole path; only "auto" is allowed'
            )
    sizes = table.horizon, table.overlap
    if "auto" not in sizes and int(table.overlap) >= int(table.horizon):
        problems.append(
            f"[correction] overlap: found {table.overlap}, but less than the horizon, "
            f"{table.horizon}, is required"
        )


def _holds_limits(table: CorrectionTable) -> bool:
    """Return whether the method can hold limits of the command."""
    return table.method == "gauss_newton" and table.command == "tip"


def _check_method(table: CorrectionTable, problems: list[str]) -> None:
    """Note what only Gauss-Newton on tip positions can hold, beside anything else."""
    for key in (
        "max_velocity",
        "max_acceleration",
        "acceleration_factor",
        "gouge",
        "stay_in_cut",
        "uncertainty",
        "start_spread",
    ):
        if getattr(table, key) in (None, False):
            continue
        for other, allowed in (("method", "gauss_newton"), ("command", "tip")):
            if (found := getattr(table, other)) != allowed:
                problems.append(
                    f'[correction] {key}: found beside {other} = "{found}", but it '
                    f'works with {other} = "{allowed}" only'
                )
