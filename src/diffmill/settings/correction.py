"""Settings of a correction: `[correction]` of a job file."""

import math
from collections.abc import Iterable
from typing import Annotated, ClassVar, Literal, NamedTuple, TypeAlias

from pydantic import BeforeValidator, Field, StrictBool, StrictInt

from .base import Leaf, ReadAs, Settings, Strategy, key
from .fields import (
    Acceleration,
    Delay,
    PositiveLength,
    PositiveSpeed,
    PositiveTime,
    Tolerance,
)
from .machine_errors import MachineErrorSettings


def _weight(value: object) -> float:
    """Weight, a number of at least 0."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        if 0 <= value < math.inf:
            return float(value)
    raise ValueError(f"found {value!r}, but a number of at least 0 is required")


def _rows(value: object) -> int | str:
    """Number of rows, or "auto"."""
    if value == "auto":
        return "auto"
    if isinstance(value, int) and not isinstance(value, bool) and value > 0:
        return value
    raise ValueError(
        f'found {value!r}, but "auto" or a number of tooth periods above 0 is required'
    )


def _factor(value: object) -> float:
    """Factor, a number of at least 1 or inf."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        if value >= 1:
            return float(value)
    raise ValueError(
        f"found {value!r}, but a number of at least 1, or inf, is required"
    )


Rows: TypeAlias = Annotated[int | Literal["auto"], BeforeValidator(_rows)]
Weight: TypeAlias = Annotated[float, BeforeValidator(_weight)]
Factor: TypeAlias = Annotated[float, BeforeValidator(_factor)]


class ObjectiveSettings(Strategy):
    """Objective of a correction: an error that becomes small.

    Its builder takes the settings, the job, the surface as it should be (None where
    that is not of walls and floors) and the weights of the rows, shape (step,).

    Attributes:
        needs_surface: True if the cut must leave walls and floors: a flat cutter that
            is upright, along +z.
        needs_whole_path: True if a path is corrected as a whole, however long it is.
        counts_contact: True if rows that only pass over the finished surface count,
            too.
    """

    needs_surface: ClassVar[bool] = False
    needs_whole_path: ClassVar[bool] = True
    counts_contact: ClassVar[bool] = False

    def faults(self) -> Iterable[str]:
        """Faults of its keys together, each beginning with a key."""
        return ()


class PathErrorSettings(ObjectiveSettings, name="path"):
    """Contour error of the tip."""

    needs_whole_path: ClassVar[bool] = False
    counts_contact: ClassVar[bool] = True


class SurfaceErrorSettings(ObjectiveSettings, name="surface"):
    """Signed error of the machined surface.

    Attributes:
        wall_weight: Weight of the walls' mean square.
        floor_weight: Weight of the floors' mean square.
    """

    wall_weight: Leaf[Weight] = key(
        'weight of the walls with objective = "surface"', default=1.0
    )
    floor_weight: Leaf[Weight] = key(
        'weight of the floors with objective = "surface"', default=1.0
    )
    needs_surface: ClassVar[bool] = True

    def faults(self) -> Iterable[str]:
        """Fault of a surface on which nothing counts."""
        if self.wall_weight == self.floor_weight == 0:
            yield (
                "wall_weight: found 0 beside floor_weight = 0, but one of them above 0 "
                "is required"
            )


class MethodSettings(Strategy):
    """Method whose command is the corrected program.

    The builder of an optimiser takes the settings, the job, the objective, the surface
    as it should be (None where that is not of walls and floors) and the plant.

    Attributes:
        is_optimiser: True if it looks for the command of the case "corrected"; else it
            is the case of its own name.
        holds_limits: True if it can hold limits of the command on positions of the tip.
        needs_whole_path: True if an optimiser corrects a path as a whole, however long
            it is.
        needs_robot: True if it is known of a robot alone.
        uses_linear_run: True if it takes the derivatives of the whole run along steps.
        steps: Largest number of steps unless a job says otherwise.
    """

    is_optimiser: ClassVar[bool] = False
    holds_limits: ClassVar[bool] = False
    needs_whole_path: ClassVar[bool] = True
    needs_robot: ClassVar[bool] = False
    uses_linear_run: ClassVar[bool] = False
    steps: ClassVar[int] = 2

    @property
    def case(self) -> str:
        """Name of the case of a correction that has the method's command."""
        return "corrected" if self.is_optimiser else self.name


class GaussNewtonSettings(MethodSettings, name="gauss_newton"):
    """Bounded Gauss-Newton on spline offsets."""

    is_optimiser: ClassVar[bool] = True
    holds_limits: ClassVar[bool] = True
    needs_whole_path: ClassVar[bool] = False
    uses_linear_run: ClassVar[bool] = True


class AdamSettings(MethodSettings, name="adam"):
    """Adam on spline offsets."""

    is_optimiser: ClassVar[bool] = True
    steps: ClassVar[int] = 60


class MirrorSettings(MethodSettings, name="mirror"):
    """Mirror of the deviation, once."""


class IteratedMirrorSettings(MethodSettings, name="mirror_iterated"):
    """Mirror of the deviation, iterated."""


class InputShaperSettings(MethodSettings, name="input_shaper"):
    """Input shaper of the slowest mode."""


class InverseDriveSettings(MethodSettings, name="inverse_drive"):
    """Motor positions that balance the forces of the rigid cut."""

    needs_robot: ClassVar[bool] = True


class LineWeight(NamedTuple):
    """Weight of a section of a program.

    Attributes:
        first: Its first line.
        last: Its last line.
        weight: Weight of the error in its rows [-].
    """

    first: int
    last: int
    weight: float


class WeightTable(Settings, table="correction.weight"):
    """Section of a program in a job file and how much it counts."""

    lines: Annotated[
        list[Annotated[StrictInt, Field(ge=0)]], Field(min_length=2, max_length=2)
    ] = key("first and last line of the section in the program, such as [120, 180]")
    value: Weight = key("weight of the error in the section, a number of at least 0")


def _sections(tables: list[WeightTable]) -> tuple[LineWeight, ...]:
    """Sections with their weights."""
    return tuple(
        LineWeight(table.lines[0], table.lines[1], table.value) for table in tables
    )


Sections: TypeAlias = Annotated[
    tuple[LineWeight, ...], ReadAs(list[WeightTable], _sections)
]


class UncertaintySettings(MachineErrorSettings, table="correction.uncertainty"):
    """Uncertainty of the model that a correction is computed with.

    Attributes:
        is_gaussian: Whether the sizes are standard deviations; else half the widths of
            intervals.
        draws: Members of the ensemble.
        seed: Seed of the draws.
        objective: Whether the "mean" square error over the members becomes small, or
            that of the "worst" of them.
        delay: Largest time by which the offsets may come late to the program [s];
            every delay from 0 on is as likely, also where the rest is normal.
    """

    is_gaussian: StrictBool = key(
        "true: the uncertainties are standard deviations; false: half the widths of "
        "intervals",
        default=False,
        name="gaussian",
    )
    draws: Annotated[StrictInt, Field(ge=1, le=100)] = key(
        "number of models that are drawn", default=4
    )
    seed: Annotated[StrictInt, Field(ge=0, le=2**31 - 1)] = key(
        "seed of the draws", default=0
    )
    objective: Literal["mean", "worst"] = key(
        "what becomes small: the mean square error over the draws, or that of the "
        "worst draw",
        default="mean",
    )
    delay: Delay = key(
        "largest time by which the offsets may come late to the program, such as "
        '"5 ms"',
        default=0.0,
    )


# What only some methods can hold, and on positions of the tip alone.
_HELD = {"method": "holds_limits", "command": "tip"}


class CorrectionSettings(Settings, table="correction"):
    """Settings of a correction.

    The keys of its objective may be given beside the objective's name.

    Attributes:
        objective: Error that becomes small: "path" (contour error of the tip),
            "surface" (signed error of the machined surface), or its settings.
        method: Method whose result is written as the corrected program, by its name
            or its settings.
        compare: "all" to run every method, the baselines' grids included; "few" for the
            one-shot mirror and the inverse drive beside the one asked for.
        command: "tip" positions (what a program carries) or "joint" angles.
        tolerance: Error that may remain [m]; half of it does not count.
        tolerance_band: Contour error that the result is held against [m], which does
            not change it; 0 for no verdict.
        sections: Sections of the program with weights of their own.
        finishing_only: Whether only rows that leave a part of the surface count.
        knot_spacing: Spacing of the B-spline knots [s], the controller's bandwidth.
        max_offset: Largest offset of the command from the desired path [m], per axis.
        max_velocity: Largest velocity of the command per axis [m/s], or infinite.
        max_acceleration: Largest acceleration of it per axis [m/s^2], or infinite.
        acceleration_factor: How many times as much as the program, at its largest on
            any axis, it may accelerate on every axis; infinite for any.
        gouge: Largest depth to which the machined surface may lie below the ideal one
            [m], or infinite.
        stay_in_cut: Whether the tool must cut at least a tenth of every layer that the
            program lets it cut to the final surface.
        uncertainty: How well the model is known; the mean square error over draws of it
            becomes small, or that of the worst. None to trust the model.
        max_steps: Steps of the optimiser at most.
        start_spread: Standard deviation of random offsets at the knots that are added
            to the command which the optimiser starts from [m].
        start_seed: Seed of these offsets.
        horizon: Rows that are corrected at once; "auto" takes a whole path of at most
            6000 rows, and segments of 2000 rows of a longer one.
        overlap: Rows at the end of a segment that the next one corrects once more;
            "auto" takes 32 knots and what the controller looks ahead, and half of the
            horizon at most.
    """

    objective: ObjectiveSettings = key(
        "what becomes small: the contour error of the tip, or the error of the "
        "machined surface",
        default="path",
        converter=ObjectiveSettings.of,
    )
    method: MethodSettings = key(
        "method whose result is written",
        default="gauss_newton",
        converter=MethodSettings.of,
    )
    compare: Literal["few", "all"] = key(
        "what runs beside the method: the one-shot mirror and the inverse drive, or "
        "every method (slow)",
        default="few",
    )
    command: Literal["tip", "joint"] = key(
        "what is corrected: positions of the tip, or joint angles", default="tip"
    )
    tolerance: Leaf[Tolerance] = key(
        'error that may remain, of which half does not count, such as "50 um"',
        default=0.0,
    )
    tolerance_band: Leaf[PositiveLength] = key(
        'contour error with which the report compares the result, such as "20 um"; '
        "changes nothing else, and is tolerance if left out",
        default=0.0,
        follows=True,
    )
    sections: Sections = key(
        "sections of the program, and how much their error counts",
        default=(),
        name="weight",
    )
    finishing_only: StrictBool = key(
        "true: only rows that leave a part of the surface count", default=False
    )
    knot_spacing: PositiveTime = key(
        "time between the knots of the correction: what the controller can follow",
        default=30e-3,
    )
    max_offset: Leaf[PositiveLength] = key(
        "largest offset of the command per axis; of joints, what moves the tip so far "
        "at the start",
        default=1e-3,
    )
    max_velocity: PositiveSpeed = key(
        'largest velocity of the whole command per axis, such as "120 mm/s"; no limit '
        "if left out",
        default=math.inf,
        works_with=_HELD,
    )
    max_acceleration: Acceleration = key(
        'largest acceleration of the whole command per axis, such as "2 m/s^2"; if '
        "left out, acceleration_factor counts",
        default=math.inf,
        works_with=_HELD,
    )
    acceleration_factor: Factor = key(
        "how many times as much as the program the command may accelerate; inf: no "
        "limit. If left out 2, but no limit beside max_acceleration, with a recorded "
        "path and with a method that keeps none",
        default=math.inf,
        follows=True,
        works_with=_HELD,
    )
    gouge: PositiveLength = key(
        'largest depth of the surface below the ideal one, such as "20 um"; no limit '
        "if left out",
        default=math.inf,
        works_with=_HELD,
    )
    stay_in_cut: StrictBool = key(
        "true: at least a tenth of every finishing layer is cut",
        default=False,
        works_with=_HELD,
    )
    uncertainty: UncertaintySettings | None = key(
        "how well the model is known, for a robust correction; if left out, the model "
        "is trusted",
        default=None,
        works_with=_HELD,
    )
    max_steps: Annotated[StrictInt, Field(ge=0, le=1000)] = key(
        "largest number of steps of the optimiser, 0 for its start as it is; if left "
        "out 2, or 60 with adam",
        default=2,
        follows=True,
    )
    start_spread: Tolerance = key(
        "standard deviation of random offsets at the knots of the start of the "
        'optimiser, such as "20 um"',
        default=0.0,
        works_with=_HELD,
    )
    start_seed: Annotated[StrictInt, Field(ge=0, le=2**31 - 1)] = key(
        "seed of the random offsets of start_spread", default=0
    )
    horizon: Rows = key(
        "tooth periods that are corrected at once; auto: segments of 2000 where a path "
        "has more than 6000, else the whole path",
        default="auto",
    )
    overlap: Rows = key(
        "tooth periods at the end of a segment that the next one corrects once more; "
        "auto: 32 knots and what the controller looks ahead, but at most half of the "
        "horizon",
        default="auto",
    )

    @property
    def optimiser(self) -> MethodSettings:
        """Method that looks for the case "corrected": Gauss-Newton beside baselines."""
        return self.method if self.method.is_optimiser else GaussNewtonSettings()
