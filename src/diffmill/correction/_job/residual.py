"""A job as pure functions for optimisers of other packages."""

import dataclasses
from collections.abc import Callable

import jax.numpy as jnp

from ..._job import Job
from ..._types import RealScalarLike
from ...process import ThroughPoses
from ...settings.correction import CorrectionSettings
from ...sim import simulate_with_slot_growth
from .._core.path_objective import (
    AbstractObjective,
    PathObjective,
    check_objective,
)
from .._core.problem import Problem
from .._method.offset_residual import OffsetResidual, offset_residual
from .correction_problem import CorrectionProblem, checked_job


def residual(
    job: Job | Problem,
    *,
    objective: AbstractObjective | None = None,
    knot_spacing: float | None = None,
    smoothness: RealScalarLike = 1e-2,
    lag_weight: RealScalarLike = 0.03,
    on_progress: Callable[[str, float], None] | None = None,
) -> OffsetResidual:
    """Correction of a job as pure functions, their arguments and a start.

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
        on_progress: Called as by `simulate`, while the uncorrected program runs.

    Raises:
        SimulationFailed: The run of the uncorrected program fails.
        ValueError: The objective is none, the machine is rigid, no row that cuts has a
            weight, or the path is too short for the knots.

    **Differentiability**: runs on the host; the functions that it returns are pure.
    """
    check_objective(objective)
    if isinstance(job, Problem):
        problem, spacing = job, CorrectionSettings.knot_spacing
        objective = PathObjective() if objective is None else objective
    else:
        job = checked_job(job)
        adjoint = ThroughPoses()
        job, before = simulate_with_slot_growth(
            job,
            jnp.asarray(job.path.positions),
            adjoint,
            on_progress or (lambda message, share: None),
        )
        before.raise_unless_successful(job)
        task = CorrectionProblem.of(job, before, adjoint, objective=objective)
        # What a run on the host alone needs is no argument of pure functions.
        plant = dataclasses.replace(task.plant, rigid=None)
        problem = dataclasses.replace(task.tips, plant=plant)
        objective, spacing = task.objective, job.correction.knot_spacing
    return offset_residual(
        problem,
        knot_spacing=spacing if knot_spacing is None else knot_spacing,
        objective=objective,
        smoothness=smoothness,
        lag_weight=lag_weight,
    )
