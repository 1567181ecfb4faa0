"""The optimiser that a job asks for, with all that it must hold."""

import dataclasses
from typing import TypeAlias

import numpy as np

from ..._job import Job
from ...settings.base import builds
from ...settings.correction import AdamSettings, GaussNewtonSettings
from .._core.method import MethodResult
from .._core.path_objective import AbstractObjective, PathObjective
from .._core.problem import Problem
from .._method.adam import Adam
from .._method.gauss_newton import GaussNewton
from .._surface.finished_surface import FinishedSurface
from .._surface.surface_limits import SurfaceBounds
from .joint_limits import JointLimits
from .objective import job_ensemble, job_spline, largest_acceleration
from .plants import TipPlant

Optimiser: TypeAlias = GaussNewton | Adam

# Steps towards the path at most: further ones improve what the surface does not see.
_STEPS_FOR_THE_PATH = 2


def job_optimiser(
    job: Job,
    objective: AbstractObjective,
    surface: FinishedSurface | None,
    plant: TipPlant,
) -> Optimiser:
    """Optimiser with the settings of a job.

    Raises:
        ValueError: Bounds of the surface are asked for where there is none.
    """
    method = job.correction.optimiser.build(job, objective, surface, plant)
    assert isinstance(method, Optimiser)
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


def for_the_path(method: Optimiser) -> GaussNewton | None:
    """Method that brings the rows near the surface onto the path; None if not needed.

    The certain model is enough for a start, and it may leave the bounds of the surface:
    on the path it is close to them, while the way to them from afar, with a spring at
    every point that is out of bounds, takes many steps. A segment of a long path begins
    where the one before it has ended, and goes that way.
    """
    if not isinstance(method, GaussNewton):
        return None
    if not method.objective.starts_from_path and method.bounds is None:
        return None
    most = min(_STEPS_FOR_THE_PATH, method.solver.max_steps)
    return dataclasses.replace(
        method,
        solver=dataclasses.replace(method.solver, max_steps=most),
        objective=PathObjective(),
        ensemble=None,
        is_worst_case=False,
        bounds=None,
    )


def out_of_bounds(method: Optimiser, found: MethodResult) -> float:
    """Distance of the surface to the method's bounds [m]; 0 within, or without any."""
    if not isinstance(method, GaussNewton) or method.bounds is None:
        return 0.0
    return method.bounds.excess(found.motion)


def job_bounds(job: Job, surface: FinishedSurface | None) -> SurfaceBounds | None:
    """Bounds of the surface that `[correction]` asks for, or None.

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


def within_joint_limits(method: Optimiser, job: Job, problem: Problem) -> Optimiser:
    """Optimiser with the limits of the joints.

    Raises:
        InfeasibleLimit: The program leaves the joints no room.
    """
    bound = float(problem.max_offset)
    limits = JointLimits(job).rows(job_spline(job), problem.nominal, bound)
    return dataclasses.replace(method, limits=limits)
