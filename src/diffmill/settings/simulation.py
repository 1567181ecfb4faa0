"""Numerical settings of a simulation: `[simulation]` of a job file."""

from typing import Annotated, ClassVar, Literal, TypeAlias

from pydantic import Field, StrictBool, StrictInt

from .base import ReadAs, Settings, Strategy, key
from .fields import PositiveLength
from .machine_errors import MachineErrorSettings


class ChipSettings(Strategy):
    """Chip model: how thick chips are, and what is removed.

    Its builder takes the settings, the sizes of an engagement by their names, and the
    bottom edges or None; it makes the engagement of a plain flat cutter that stands
    upright.

    Attributes:
        disc_height: Height of a disc in ray spacings unless asked for [-].
        needs_plain_cutter: True if the cutter must be flat, with even pitch and without
            run-out, and stand along +z; else any other cutter is engaged by its edge
            elements, with the chips of "near_far".
        updates_within_period: True if the stock can be read more than once in a tooth
            period.
        has_bottom_edges: True if bottom edges can cut.
    """

    disc_height: ClassVar[float] = 1.0
    needs_plain_cutter: ClassVar[bool] = True
    updates_within_period: ClassVar[bool] = False
    has_bottom_edges: ClassVar[bool] = False


class NearFarSettings(ChipSettings, name="near_far"):
    """Chips from the circles of earlier poses; smooth."""

    disc_height: ClassVar[float] = 3.5
    needs_plain_cutter: ClassVar[bool] = False
    updates_within_period: ClassVar[bool] = True
    has_bottom_edges: ClassVar[bool] = True


class PointCloudSettings(ChipSettings, name="point_cloud"):
    """Chips from the points that a pose takes from the stock, as in the paper; hard.

    Discs are one ray high there.
    """


class IntegratorSettings(Strategy):
    """Rule of the sub-steps of an arm.

    Its builder takes the settings and the algorithm of the dynamics, "crba" or "aba".
    """


class MidpointSettings(IntegratorSettings, name="midpoint"):
    """Linearly implicit midpoint rule."""


class RungeKutta4Settings(IntegratorSettings, name="rk4"):
    """Explicit rule of fourth order, to verify the other by."""


class ModeSettings(Strategy):
    """Equations by which an arm moves.

    Its builder takes the settings, the job and its robot, and makes the machine.

    Attributes:
        vibrates: True if the arm has a mass, so that it can vibrate.
        needs_whole_path: True if a path is corrected as a whole, however long it is.
    """

    vibrates: ClassVar[bool] = True
    needs_whole_path: ClassVar[bool] = True


class DynamicSettings(ModeSettings, name="dynamic"):
    """Equations of motion, sub-step by sub-step."""

    needs_whole_path: ClassVar[bool] = False


class QuasistaticSettings(ModeSettings, name="quasistatic"):
    """Springs that balance the mean force of each tooth period, without inertia."""

    vibrates: ClassVar[bool] = False


class ScatterSettings(MachineErrorSettings, table="simulation.scatter"):
    """Standard deviations of machines about the model, relative or with a unit."""


def _stability(value: bool | str) -> str:
    """Way to look for chatter."""
    if isinstance(value, bool):
        return "full" if value else "none"
    return value


Stability: TypeAlias = Annotated[
    Literal["quick", "full", "none"], ReadAs(StrictBool | Literal["quick"], _stability)
]


class SimulationSettings(Settings, table="simulation"):
    """Settings of a simulation.

    Attributes:
        angles: Samples of the immersion angle per revolution; a multiple of teeth x
            substeps.
        substeps: Steps of the robot within one tooth period.
        element_height: Height dz of a disc of the cutter [m].
        axial_depth: Deepest immersion that the discs reach [m].
        precision: "float64" or "float32".
        is_gravity_compensated: Whether the controller lifts the gravity sag.
        plunges: Whether the path descends in material.
        has_bottom: Whether bottom edges cut where the tool descends.
        axes: Directions of the tool that occur, rounded; empty if it is upright
            and the bending arm is not to tilt it.
        chip: Chip model: "near_far", "point_cloud" (hard, as in the paper), or its
            settings.
        integrator: Rule of the robot's sub-steps: "midpoint", "rk4" (explicit, to
            verify the other by), or its settings.
        dynamics: Algorithm of the robot's dynamics, "crba" or "aba".
        mode: Equations of the arm: "dynamic", "quasistatic" (springs balance the mean
            force of each tooth period, without inertia), or its settings.
        has_sensitivity: Whether the command line adds maps of the sensitivity.
        stability: How the command line looks for chatter after a run: "quick", where
            the cut is deepest, and it says nothing of a stable one; "full", along the
            path; or "none".
        updates_per_period: Engagement updates of a tooth period.
        resolution: "every tooth": each tooth period has its engagement update;
            "adaptive": in `simulate`, several periods share one where the cut is
            steady; corrections and learning have one in each.
        scatter: How far the machine may be from the model; the command line adds the
            error to be expected then. None if it is not known.
        tilts: Whether a job file asks that the bending arm tilts the tool, for `axes`.
    """

    angles: Annotated[StrictInt, Field(ge=1, le=100_000)] = key(
        "samples per revolution, a multiple of teeth times substeps; if left out at "
        "least 180 for an upright flat cutter of even pitch without run-out, else 96",
        follows=True,
    )
    substeps: Annotated[StrictInt, Field(ge=1, le=1000)] = key(
        "steps of the machine in a tooth period; if left out 0.5 ms long at most, and "
        "as short as the modes of the machine need",
        follows=True,
    )
    element_height: PositiveLength = key(
        'height of the discs of the cutter, such as "0.2 mm"; if left out, it follows '
        "from the spacing of the stock and the helix angle",
        follows=True,
    )
    axial_depth: PositiveLength = key(
        'deepest immersion that is computed, such as "3 mm"; that of the path if left '
        "out",
        follows=True,
    )
    precision: Literal["float64", "float32"] = key(
        "precision of all numbers", default="float64"
    )
    is_gravity_compensated: StrictBool = key(
        "false: the controller leaves the sag of the arm",
        default=True,
        name="gravity_compensated",
    )
    plunges: bool = False
    has_bottom: StrictBool = key(
        "whether bottom edges cut where the tool descends, so that plunges push along "
        "the axis; if left out they do of a rigid machine and of an end with a "
        "dish_angle",
        default=False,
        name="bottom_edges",
        follows=True,
    )
    axes: tuple[tuple[float, float, float], ...] = ()
    chip: ChipSettings = key(
        "chip model; point_cloud is the hard one of the paper, for flat cutters of "
        "even pitch without run-out",
        default="near_far",
        converter=ChipSettings.of,
    )
    integrator: IntegratorSettings = key(
        "rule of the substeps; rk4 is explicit and slow, to verify the other by",
        default="midpoint",
        converter=IntegratorSettings.of,
    )
    dynamics: Literal["crba", "aba"] = key(
        "algorithm of the dynamics of the arm; aba, by articulated bodies, gives the "
        "same answer",
        default="crba",
    )
    mode: ModeSettings = key(
        "quasistatic: the arm bends but does not swing",
        default="dynamic",
        converter=ModeSettings.of,
    )
    has_sensitivity: StrictBool = key(
        "true: also says what 10 % more stiffness, damping, force, ... does",
        default=False,
        name="sensitivity",
    )
    stability: Stability = key(
        "true: chatter is examined along the whole path; quick: only where most is "
        "cut; false: nowhere",
        default="quick",
    )
    updates_per_period: int = 1
    resolution: Literal["every tooth", "adaptive"] = key(
        "adaptive: several tooth periods share an engagement update where the cut is "
        "steady, which is faster, but in correct and learn; for cutters with even "
        "pitch and without run-out, and not for the amplitude of chatter",
        default="every tooth",
    )
    scatter: ScatterSettings | None = key(
        "how far machines may be from the model, to add the contour error to be "
        "expected; not computed if left out",
        default=None,
    )
    tilts: StrictBool = key(
        "true: the bending arm also tilts the tool (slower)",
        default=False,
        name="tool_tilt",
    )
