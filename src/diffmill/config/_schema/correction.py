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
    """An entry of `[correction] weight`: a section and how much it counts."""

    lines: Annotated[
        list[Annotated[StrictInt, Field(ge=0)]], Field(min_length=2, max_length=2)
    ] = Field(
        description="first and last line of the section in the program, such as "
        "[120, 180]"
    )
    value: Weight = Field(
        description="weight of the error in the section, a number of at least 0"
    )


class UncertaintyTable(TomlTable):
    """`[correction.uncertainty]`: how well the model is known, mostly relative."""

    stiffness: Uncertainty = Field(
        default=0.0, description="relative uncertainty of the stiffness, such as 0.2"
    )
    damping: Uncertainty = Field(
        default=0.0, description="relative uncertainty of the damping, such as 0.2"
    )
    force: Uncertainty = Field(
        default=0.0,
        description="relative uncertainty of the force coefficients, such as 0.1",
    )
    gaussian: StrictBool = Field(
        default=False,
        description="true: the uncertainties are standard deviations; false: half the "
        "widths of intervals",
    )
    draws: Annotated[StrictInt, Field(ge=1, le=100)] = Field(
        default=4, description="number of models that are drawn"
    )
    seed: Annotated[StrictInt, Field(ge=0, le=2**31 - 1)] = Field(
        default=0, description="seed of the draws"
    )
    objective: Literal["mean", "worst"] = Field(
        default="mean",
        description="what becomes small: the mean square error over the draws, or that "
        "of the worst draw",
    )
    delay: Delay = Field(
        default=0.0,
        description="largest time by which the offsets may come late to the program, "
        'such as "5 ms"',
    )


class CorrectionTable(TomlTable):
    """`[correction]`."""

    objective: Literal["path", "surface"] = Field(
        default="path",
        description="what becomes small: the contour error of the tip, or the error of "
        "the machined surface",
    )
    method: Literal[
        "gauss_newton",
        "adam",
        "mirror",
        "mirror_iterated",
        "input_shaper",
        "inverse_drive",
    ] = Field(default="gauss_newton", description="method whose result is written")
    compare: Literal["few", "all"] = Field(
        default="few",
        description="what runs beside the method: the one-shot mirror and the inverse "
        "drive, or every method (slow)",
    )
    command: Literal["tip", "joint"] = Field(
        default="tip",
        description="what is corrected: positions of the tip, or joint angles",
    )
    tolerance: Tolerance = Field(
        default=0.0,
        description="error that may remain, of which half does not count, such as "
        '"50 um"',
    )
    tolerance_band: PositiveLength | None = Field(
        default=None,
        description="contour error that the report holds the result against, such as "
        '"20 um"; changes nothing else, and is tolerance if left out',
    )
    weight: list[WeightTable] = Field(
        default_factory=list,
        description="sections of the program, and how much their error counts",
    )
    finishing_only: StrictBool = Field(
        default=False,
        description="true: only rows that leave a part of the surface count",
    )
    wall_weight: Weight = Field(
        default=1.0, description='weight of the walls with objective = "surface"'
    )
    floor_weight: Weight = Field(
        default=1.0, description='weight of the floors with objective = "surface"'
    )
    knot_spacing: PositiveTime = Field(
        default=30e-3,
        description="time between the knots of the correction: what the controller can "
        "follow",
    )
    max_offset: PositiveLength = Field(
        default=1e-3,
        description="largest offset of the command per axis; of joints, what moves the "
        "tip so far at the start",
    )
    max_velocity: PositiveSpeed | None = Field(
        default=None,
        description="largest velocity of the whole command per axis, such as "
        '"120 mm/s"; no limit if left out',
    )
    max_acceleration: Acceleration | None = Field(
        default=None,
        description="largest acceleration of the whole command per axis, such as "
        '"2 m/s^2"; if left out, acceleration_factor holds',
    )
    acceleration_factor: Factor | None = Field(
        default=None,
        description="how many times as much as the program the command may accelerate; "
        "inf: no limit. If left out 2, but no limit beside max_acceleration, with a "
        "recorded path and with a method that holds none",
    )
    gouge: PositiveLength | None = Field(
        default=None,
        description="largest depth of the surface below the ideal one, such as "
        '"20 um"; no limit if left out',
    )
    stay_in_cut: StrictBool = Field(
        default=False,
        description="true: at least a tenth of every finishing layer is cut",
    )
    uncertainty: UncertaintyTable | None = Field(
        default=None,
        description="how well the model is known, for a robust correction; if left "
        "out, the model is trusted",
    )
    max_steps: Annotated[StrictInt, Field(ge=1, le=1000)] | None = Field(
        default=None,
        description="largest number of steps of the optimiser; if left out 2, or 60 "
        "with adam",
    )
    start_spread: Tolerance = Field(
        default=0.0,
        description="standard deviation of random offsets at the knots of the start of "
        'the optimiser, such as "20 um"',
    )
    start_seed: Annotated[StrictInt, Field(ge=0, le=2**31 - 1)] = Field(
        default=0, description="seed of the random offsets of start_spread"
    )
    horizon: Rows = Field(
        default="auto",
        description="tooth periods that are corrected at once; auto: segments of 2000 "
        "where a path has more than 6000, else the whole path",
    )
    overlap: Rows = Field(
        default="auto",
        description="tooth periods at the end of a segment that the next one corrects "
        "once more; auto: 32 knots and what the controller looks ahead, but at most "
        "half of the horizon",
    )


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
    *,
    mode: str,
) -> None:
    """Note settings that the cutter, the path, the mode or others do not allow."""
    _check_segments(table, mode, problems)
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


def _check_segments(table: CorrectionTable, mode: str, problems: list[str]) -> None:
    """Note a horizon beside what needs the whole path, or too short for its overlap."""
    for beside, is_whole in (
        ('objective = "surface"', table.objective == "surface"),
        ("an uncertainty", table.uncertainty is not None),
        ('method = "adam"', table.method == "adam"),
        ('[simulation] mode = "quasistatic"', mode == "quasistatic"),
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
