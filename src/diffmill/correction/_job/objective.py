"""From the settings of a job to weights, objective and surface of its correction."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ..._job import Job
from ..._types import BoolSteps
from ...settings.base import builds
from ...settings.correction import PathErrorSettings, SurfaceErrorSettings
from ...sim import Run, drawn_machine
from .._core.method import MethodResult
from .._core.path_objective import AbstractObjective, PathObjective
from .._core.problem import Motion, Problem
from .._core.row_weights import row_weights
from .._method.ensemble import DelayedPlant, Ensemble
from .._spline.command_limits import LinearLimits
from .._spline.spline_offsets import SplineOffsets
from .._surface.finished_surface import FinishedSurface
from .._surface.surface_objective import SurfaceObjective
from .plants import MachinePlants, ScaledPlant, TipPlant


class UnsuitableSettings(ValueError):
    """Raise when settings of the correction do not suit the path of the job."""


def job_weights(
    job: Job, rigid: Run, is_cutting: BoolSteps, surface: FinishedSurface | None
) -> Float[np.ndarray, " step"]:
    """Weight of every row, as `[correction]` states.

    On the path, rows that only pass over the surface count a little: nothing else keeps
    the command from swinging into what has been cut.

    Raises:
        ValueError: No row that cuts has a weight.
    """
    settings = job.correction
    steps = np.linalg.norm(np.diff(np.asarray(job.path.positions), axis=0), axis=1)
    feed = np.median(steps[np.asarray(is_cutting, bool)[1:]])
    # The next ray is a spacing away, in which the tool may advance by several rows.
    spread = int(np.ceil(job.stock.spacing / max(feed, 1e-2 * job.stock.spacing)))
    is_touching = None
    if surface is not None and settings.objective.counts_contact:
        is_touching = surface.touching_rows(np.asarray(job.path.positions))
    return row_weights(
        is_cutting,
        job.path.line,
        sections=settings.sections,
        finished=rigid.stock if settings.finishing_only else None,
        spread=spread,
        is_touching=is_touching,
    )


def job_surface(
    job: Job, rigid: Run, wall_share: Float[Array, " step"]
) -> FinishedSurface | None:
    """Surface as it should be; None where it is not of walls and floors.

    It is for a flat cutter that is upright and leaves something of what it cut.
    """
    if not job.cutter.is_plain or job.simulation.axes:
        return None
    try:
        return FinishedSurface.from_cut(
            rigid.stock,
            job.path.positions,
            job.cutter.nominal_radius,
            shares=np.asarray(wall_share),
        )
    except ValueError:
        return None


def check_limits(job: Job) -> None:
    """Raise before anything runs if the program itself breaks a limit.

    Raises:
        InfeasibleLimit: It does.
        UnsuitableSettings: The program is too short for the knots.
    """
    LinearLimits.of_command(
        job_spline(job),
        job.path.positions,
        max_velocity=job.correction.max_velocity,
        max_acceleration=largest_acceleration(job),
        unit="m",
    )


def largest_acceleration(job: Job) -> float:
    """Largest acceleration of the corrected command per axis [m/s^2]."""
    settings = job.correction
    if not np.isfinite(settings.acceleration_factor):
        return settings.max_acceleration
    steps = np.diff(np.asarray(job.path.positions, np.float64), 2, axis=0)
    own = np.abs(steps).max(initial=0.0) / float(job.tooth_period) ** 2
    return min(settings.max_acceleration, settings.acceleration_factor * float(own))


# Part of a tolerance that is aimed at: what is left keeps the whole of it.
_AIMED = 0.5


def job_spline(job: Job) -> SplineOffsets:
    """Basis of a job's offsets.

    Raises:
        UnsuitableSettings: The program is too short for the knots.
    """
    spacing = job.correction.knot_spacing
    try:
        return SplineOffsets(job.path.step_count, float(job.tooth_period), spacing)
    except ValueError as error:
        raise UnsuitableSettings(str(error)) from error


def job_objective(
    job: Job,
    surface: FinishedSurface | None,
    weights: Float[np.ndarray, " step"],
) -> AbstractObjective:
    """Objective that `[correction]` states, with the weights of the rows.

    Args:
        job: The job.
        surface: The surface as it should be; None where it is not of walls and floors.
        weights: Weights of the rows, shape (step,).

    Raises:
        UnsuitableSettings: A surface is asked for where there is none.
        ValueError: What the settings build is no objective.
    """
    objective = job.correction.objective.build(job, surface, weights)
    if not isinstance(objective, AbstractObjective):
        raise ValueError(
            f"Argument `job` must have an objective, but builds {objective!r}."
        )
    return objective


@builds(PathErrorSettings)
def _path_objective(
    settings: PathErrorSettings,
    job: Job,
    surface: FinishedSurface | None,
    weights: Float[np.ndarray, " step"],
) -> PathObjective:
    return PathObjective(_AIMED * job.correction.tolerance)


@builds(SurfaceErrorSettings)
def _surface_objective(
    settings: SurfaceErrorSettings,
    job: Job,
    surface: FinishedSurface | None,
    weights: Float[np.ndarray, " step"],
) -> SurfaceObjective:
    if surface is None:
        raise UnsuitableSettings(
            'Argument `job` must have the objective "path", but has "surface", which '
            "needs a flat cutter along +z that leaves walls or floors."
        )
    return SurfaceObjective(
        surface,
        settings.wall_weight,
        settings.floor_weight,
        _AIMED * job.correction.tolerance,
        surface.point_shares(job.path.positions, weights),
    )


def job_ensemble(
    job: Job, nominal: TipPlant, machines: Sequence[Job] | None = None
) -> Ensemble | None:
    """Machines on which the program may run, for a robust correction.

    Args:
        job: The job.
        nominal: Its plant.
        machines: The machines; if None those that `[correction.uncertainty]` draws.
            Where no more than stiffness, damping and forces is uncertain they are the
            model's own with other numbers, else each is touched off (`drawn_machine`).

    Returns:
        The ensemble; None where the model is certain.
    """
    known = job.correction.uncertainty
    if machines is None and known is not None and known.robot_errors:
        machines = [drawn_machine(job, known, draw) for draw in range(known.draws)]
    if machines is not None:
        plant = MachinePlants(nominal, tuple(one.with_precision() for one in machines))
        draws = np.arange(float(len(machines)))[:, None]
    elif known is not None:
        plant = ScaledPlant(nominal)
        draws = Ensemble.draw_scales(
            job.parameter_names,
            count=known.draws,
            seed=known.seed,
            stiffness=known.stiffness,
            damping=known.damping,
            force=known.force,
            is_gaussian=known.is_gaussian,
        )
    else:
        return None
    if known is None or known.delay == 0:
        return Ensemble(plant, draws)
    # The path is the uncorrected command: only what is added to it comes late.
    late = DelayedPlant(plant, np.asarray(job.path.positions), float(job.tooth_period))
    return Ensemble(
        late, DelayedPlant.with_delays(draws, largest=known.delay, seed=known.seed)
    )


def remaining_error(
    objective: AbstractObjective, problem: Problem, found: MethodResult
) -> float:
    """Root mean square of the error that an objective makes small [m].

    Infinite where the motion is not finite.
    """
    errors = _errors(objective, problem.without_plant, found.motion)
    errors = np.asarray(errors, np.float64)
    return float(np.sqrt(np.sum(errors**2))) if np.isfinite(errors).all() else np.inf


@eqx.filter_jit
def _errors(
    objective: AbstractObjective, problem: Problem, motion: Motion
) -> Float[Array, " error"]:
    return objective.errors(problem, motion, 0.0)
