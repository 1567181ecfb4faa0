"""A job as pure functions for optimisers of other packages."""

from typing import NamedTuple

import jax.numpy as jnp

from ..._job import CorrectionSettings, Job
from ..._types import RealScalarLike
from ...process import ThroughPoses
from ...sim import simulate_with_slot_growth
from .._core.path_objective import (
    AbstractObjective,
    PathObjective,
    check_objective,
)
from .._core.problem import Problem
from .._method.offset_residual import OffsetResidual, offset_residual
from .objective import job_objective, job_surface, job_weights
from .plants import TipPlant, job_problem


def residual(
    job: Job | Problem,
    *,
    objective: AbstractObjective | None = None,
    knot_spacing: float | None = None,
    smoothness: RealScalarLike = 1e-2,
    lag_weight: RealScalarLike = 0.03,
) -> OffsetResidual:
    """Return the correction of a job as pure functions, their arguments and a start.

        fit = dm.correction.residual(job)
        optimistix.least_squares(fit.residual, solver, fit.start, fit.args)
        optimistix.minimise(fit.cost, solver, fit.start, fit.args)
        jax.value_and_grad(fit.cost)(unknowns, fit.args)  # for optax, scipy

    The unknowns are those of `GaussNewton`: spline coefficients of the offset of the
    commanded tip, here divided by `max_offset`. Limits of the command are not held:
    unknowns between -1 and 1 keep to `max_offset`, everything else is up to the
    optimiser. The uncorrected program
    runs once here.

    Args:
        job: The job, whose machine must not be rigid; or a problem with a plant of
            one's own.
        objective: The error that is to become small; that of the job, or of the path,
            if not given.
        knot_spacing: Smallest spacing of the knots [s]; that of the job if not given.
        smoothness: Weight of the roughness, see `GaussNewton`.
        lag_weight: Weight of the deviation along the path, see `GaussNewton`.

    Raises:
        SimulationFailed: The run of the uncorrected program fails.
        ValueError: The objective is none, the machine is rigid, no row that cuts has a
            weight, or the path is too short for the knots.

    **Differentiability**: runs on the host; the functions that it returns are pure.
    """
    check_objective(objective)
    if isinstance(job, Problem):
        own = _OffsetProblem(job, PathObjective(), CorrectionSettings.knot_spacing)
    else:
        own = _tip_problem(job)
    return offset_residual(
        own.problem,
        knot_spacing=own.knot_spacing if knot_spacing is None else knot_spacing,
        objective=own.objective if objective is None else objective,
        smoothness=smoothness,
        lag_weight=lag_weight,
    )


class _OffsetProblem(NamedTuple):
    """A problem with its own objective and smallest spacing of the knots [s]."""

    problem: Problem
    objective: AbstractObjective
    knot_spacing: float


def _tip_problem(job: Job) -> _OffsetProblem:
    """Return the problem of a job in tip positions."""
    job = job.with_precision()
    if job.is_rigid:
        raise ValueError("Argument `job` must not have a rigid machine, but has.")
    adjoint, desired = ThroughPoses(), jnp.asarray(job.path.positions)
    job, before = simulate_with_slot_growth(
        job, desired, adjoint, lambda message, share: None
    )
    before.raise_unless_successful(job)
    surface = job_surface(job, before.rigid, before.wall_share)
    weights = job_weights(job, before.rigid, before.is_cutting, surface)
    plant = TipPlant(job, adjoint, before.wall_share)
    problem = job_problem(job, plant, desired, before, weights)
    objective = job_objective(job, surface, weights)
    return _OffsetProblem(problem, objective, job.correction.knot_spacing)
