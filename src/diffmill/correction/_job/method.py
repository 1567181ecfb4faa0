"""The optimiser that a job asks for, with all that it must hold."""

import dataclasses

import numpy as np

from ..._job import Job
from ...settings.base import builds
from ...settings.correction import AdamSettings, GaussNewtonSettings
from .._core.path_objective import AbstractObjective
from .._core.problem import Problem
from .._method.adam import Adam
from .._method.gauss_newton import GaussNewton
from .._method.optimiser import AbstractOptimiser
from .._surface.finished_surface import FinishedSurface
from .._surface.surface_limits import SurfaceBounds
from .joint_limits import JointLimits
from .objective import job_ensemble, job_spline, largest_acceleration
from .plants import TipPlant


def job_optimiser(
    job: Job,
    objective: AbstractObjective,
    surface: FinishedSurface | None,
    plant: TipPlant,
) -> AbstractOptimiser:
    """Optimiser with the settings of a job.

    Raises:
        ValueError: Bounds of the surface are asked for where there is none.
    """
    method = job.correction.optimiser.build(job, objective, surface, plant)
    assert isinstance(method, AbstractOptimiser)
    return method


@builds(AdamSettings)
def _adam(
    settings: AdamSettings,
    job: Job,
    objective: AbstractObjective,
    surface: FinishedSurface | None,
    plant: TipPlant,
) -> Adam:
    return Adam(
        knot_spacing=job.correction.knot_spacing,
        steps=job.correction.max_steps,
        objective=objective,
    )


@builds(GaussNewtonSettings)
def _gauss_newton(
    settings: GaussNewtonSettings,
    job: Job,
    objective: AbstractObjective,
    surface: FinishedSurface | None,
    plant: TipPlant,
) -> GaussNewton:
    asked = job.correction
    known = asked.uncertainty
    return GaussNewton(
        knot_spacing=asked.knot_spacing,
        solver=dataclasses.replace(GaussNewton.solver, max_steps=asked.max_steps),
        objective=objective,
        ensemble=job_ensemble(job, plant),
        is_worst_case=known is not None and known.objective == "worst",
        bounds=job_bounds(job, surface),
        max_velocity=asked.max_velocity,
        max_acceleration=largest_acceleration(job),
    )


def job_bounds(job: Job, surface: FinishedSurface | None) -> SurfaceBounds | None:
    """Bounds of the surface that `[correction]` states, or None.

    Raises:
        ValueError: They are asked for where there is no surface of walls and floors.
    """
    settings = job.correction
    if not (settings.stay_in_cut or np.isfinite(settings.gouge)):
        return None
    if surface is None:
        raise ValueError(
            "Argument `job` must have neither `gouge` nor `stay_in_cut`, which need a "
            "flat cutter along +z that leaves walls or floors."
        )
    layers = None
    if settings.stay_in_cut:
        layers = SurfaceBounds.layer_thickness(surface, job.stock, job.path.positions)
    return SurfaceBounds.about(surface, gouge=settings.gouge, layers=layers)


def within_joint_limits(
    method: AbstractOptimiser, job: Job, problem: Problem
) -> AbstractOptimiser:
    """Optimiser with the limits of the joints.

    Raises:
        InfeasibleLimit: The program leaves the joints no room.
    """
    bound = float(problem.max_offset)
    limits = JointLimits(job).rows(job_spline(job), problem.nominal, bound)
    return dataclasses.replace(method, limits=limits)
