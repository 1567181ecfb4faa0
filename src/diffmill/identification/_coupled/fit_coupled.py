"""Force coefficients, joint stiffness and damping from one record of a robot that cuts.

What pushes the arm and how far it yields are one simulation, so one record of forces
and deflections can tell both. Where only deflections were measured, the coefficients
must be known: a soft arm and a large force look alike.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ..._job import Job
from ..._result import RESULTS, SimulationFailed
from ...optimise import (
    AbstractProblem,
    LeastSquaresState,
    LevenbergMarquardt,
    QuadraticModel,
    least_squares,
)
from .._statistics.record_model import record_model, record_solver
from .._statistics.robust_regression import (
    LinearFit,
    Loss,
    Rows,
    correlation_of,
    covariance,
    weigh,
)
from .model import (
    CoupledRecord,
    Modelled,
    Table,
    coupled_rows,
    modelled,
    parameter_values,
    scaled_job,
)
from .parameters import fitted_names, fixed_parameter_note
from .report import EXPLAINED, coupled_notes, explained_by

# A parameter is a number if its relative standard error is at most this: two of them
# are 5 %.
_RELATIVE_ERROR = 0.025
_STEPS = 25
# Stiffness of all joints, over that given, where a second attempt may start.
_SCALES = (0.1, 0.25, 0.5, 2.0, 4.0)


class CoupledFit(eqx.Module):
    """Parameters of arm and cut, how sure they are, and which are not identifiable.

    Attributes:
        parameters: By name, in SI: "K" and "D" with a joint's name, and the force
            law's own names; NaN if not identifiable.
        standard_errors: By name, same units; infinite if nothing is known.
        correlation: Between their logarithms in the order of `names`, shape
            (parameter, parameter); NaN where nothing is known.
        covariance: Of the logarithms, same shape; infinite where nothing is known.
        identifiable: By name: whether the record fixes the parameter.
        log_scale: Logarithms of fitted over given parameter, identifiable or not, in
            the order of `names`, shape (parameter,).
        explained: Share of the square of what was measured that the fit explains, for
            "force" and "deviation", as far as measured (the deviation without its
            offset).
        residual_rms: Root mean square of measured minus fitted, likewise [N, m].
        residual: Measured minus fitted, likewise, shape (row, 3); NaN where not
            measured or off the path.
        offset: Constant part of the measured deviation [m], shape (3,), or None.
        time_shift: Time of the path minus time of the record [s].
        time_shift_error: Standard error [s]; 0 if the shift was not fitted.
        has_converged: Whether the last step was small.
        simulations: Simulations with derivatives that it took.
        is_explained: Whether it explains enough of each to be trusted.
        notes: What to know, in words.
        job: The job with the fitted parameters; what is not identifiable is as given.
    """

    parameters: dict[str, float]
    standard_errors: dict[str, float]
    correlation: Float[np.ndarray, "parameter parameter"]
    covariance: Float[np.ndarray, "parameter parameter"]
    identifiable: dict[str, bool]
    log_scale: Float[np.ndarray, " parameter"]
    explained: dict[str, float]
    residual_rms: dict[str, float]
    residual: dict[str, Float[np.ndarray, "row 3"]]
    offset: Float[np.ndarray, " 3"] | None
    time_shift: float
    time_shift_error: float
    has_converged: bool
    simulations: int
    is_explained: bool
    notes: tuple[str, ...] = eqx.field(static=True)
    job: Job

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters in the order of the arrays."""
        return tuple(self.parameters)


def fit_coupled(
    job: Job,
    *,
    force: Table | None = None,
    deviation: Table | None = None,
    time: Table | None = None,
    fit: Sequence[str] | None = None,
    has_offset: bool = False,
    has_time_shift: bool = False,
    loss: Loss = "huber",
    max_relative_error: float = _RELATIVE_ERROR,
    max_steps: int = _STEPS,
    on_progress: Callable[[str], None] | None = None,
) -> CoupledFit:
    """Fit stiffness, damping and force coefficients to a record of a robot's cut.

    Every step of a damped Gauss-Newton iteration runs the coupled simulation once, with
    exact derivatives. The parameters of the job are where it starts; a factor of
    several off does no harm: a fit that explains little is begun again from an arm that
    is softer or stiffer as a whole. A record that is sampled faster than the tooth
    passing needs its mean over a tooth period first (`mean_over_period`), since that is
    what the simulated force is; the tip is compared at the tooth instants, and on
    straight lines between them.

    Args:
        job: The job that was run; its machine must be a robot. If its controller
            compensates the sag, then that of the true arm.
        force: Force on the tool in `work`, mean over the tooth period before each
            instant [N], shape (row, 3); NaN where not measured.
        deviation: Tip minus desired tip in `work` [m], shape (row, 3), likewise.
        time: Instants [s], ascending, on the clock of the job's path, shape (row,);
            the tooth instants of the path if not given.
        fit: Names of what is fitted, see `Job.parameter_names`, all else being known;
            "K" or "D" alone for those of all joints. Stiffness and damping of all
            joints if not given, and the coefficients if the force was measured, as far
            as they are finite and not 0 in the job; all keep their sign.
        has_offset: Whether a constant deviation is fitted too, as of a tracker whose
            zero is not known.
        has_time_shift: Whether a shift of the record's clock is fitted too; its start
            is 0, so that it must be small against the shortest period of the arm.
        loss: "squares" or "huber".
        max_relative_error: A parameter is a number if its relative standard error is
            at most this.
        max_steps: Steps at most.
        on_progress: Called with a message after each step.

    Returns:
        The fit; read `.notes`.

    Raises:
        ValueError: No robot, nothing measured, wrong shapes or names.
        SimulationFailed: The job with its own parameters cannot be simulated.
    """
    if job.robot is None:
        raise ValueError("Argument `job` must have a robot, but its machine is rigid.")
    if loss not in ("squares", "huber"):
        raise ValueError(
            f'Argument `loss` must be "squares" or "huber", but is "{loss}".'
        )
    job = job.with_precision()
    record = _record(job, force, deviation, time)
    names = fitted_names(job, fit, force is not None)
    start = np.zeros(len(names) + 3 * has_offset + has_time_shift)
    problem = _Problem(job, record, names, has_offset, has_time_shift, start, loss)
    first = problem.simulated(start)
    if first.result != RESULTS.successful:
        raise SimulationFailed(RESULTS[first.result])
    begun = problem.rows(first, start)
    if not any(np.isfinite(part.force).any() for part in begun):
        raise ValueError(
            "Argument `time` must overlap the path, from 0 to "
            f"{float(job.path.time[-1]):g} s, with something measured, but does not."
        )
    solver = record_solver(problem.is_log, max_steps)
    tell = on_progress or (lambda message: None)

    def after(step: LeastSquaresState) -> None:
        share = 100 * problem.share(step.value, step.x)
        tell(
            f"step {len(step.history)} of at most {max_steps} explains {share:.1f} % "
            "of the record"
        )

    state = LeastSquaresState(start, begun, solver.damping)
    solution = least_squares(problem, start, solver, state=state, callback=after)
    if problem.share(solution.value, solution.x) < EXPLAINED:
        # Far from the truth all slopes are small, and ringing has minima of its own.
        tell("an arm that is softer or stiffer as a whole")
        solution = _other_start(problem, solver, state, solution, after)
    unfitted = () if fit is not None else fixed_parameter_note(job, force is not None)
    return _report(problem, solution, max_relative_error, unfitted)


class _Problem(AbstractProblem):
    """The equations of a record at any unknowns."""

    job: Job
    record: CoupledRecord
    names: tuple[str, ...] = eqx.field(static=True)
    has_offset: bool = eqx.field(static=True)
    has_time_shift: bool = eqx.field(static=True)
    start: np.ndarray
    loss: Loss = eqx.field(static=True)

    @property
    def is_log(self) -> np.ndarray:
        """True for unknowns that are logarithms of parameters: the first."""
        return np.arange(len(self.start)) < len(self.names)

    def simulated(self, x: np.ndarray) -> Modelled:
        """Simulation at some unknowns."""
        everything = self.job.parameter_names
        places = tuple(everything.index(name) for name in self.names)
        return modelled(self.job, places, x[: len(places)])

    def offset(self, x: np.ndarray) -> np.ndarray | None:
        """Offset of the deviation among the unknowns [m], or None."""
        count = len(self.names)
        return x[count : count + 3] if self.has_offset else None

    def time_shift(self, x: np.ndarray) -> float | None:
        """Time shift among the unknowns [s], or None."""
        return float(x[-1]) if self.has_time_shift else None

    def rows(self, model: Modelled, x: np.ndarray) -> list[Rows]:
        """Equations at some unknowns, for their simulation."""
        period = float(self.job.tooth_period)
        turn = period * self.job.cutter.flute_count
        offset, shift = self.offset(x), self.time_shift(x)
        return coupled_rows(self.record, model, period, turn, offset, shift)

    def evaluate(self, x: np.ndarray) -> list[Rows] | None:
        """Equations at some unknowns, None where the run fails."""
        model = self.simulated(x)
        return None if model.result != RESULTS.successful else self.rows(model, x)

    def model(self, x: np.ndarray, value: list[Rows]) -> QuadraticModel:
        """Quadratic model of the robust cost."""
        return record_model(value, x, self.start, self.is_log, self.loss)

    def fit(self, rows: list[Rows]) -> LinearFit:
        """Weights, spreads and residuals of some equations."""
        return weigh(rows, np.zeros(len(self.start)), self.loss)

    def share(self, rows: list[Rows], x: np.ndarray) -> float:
        """Smallest share of the squares that some unknowns explain."""
        fit = self.fit(rows)
        return min(explained_by(self.measured, fit, self.offset(x)).values())

    @property
    def measured(self) -> dict[str, np.ndarray | None]:
        """Measurements by name."""
        return {"force": self.record.force, "deviation": self.record.deviation}


def _other_start(
    problem: _Problem,
    solver: LevenbergMarquardt,
    first: LeastSquaresState,
    solution: LeastSquaresState,
    callback: Callable[[LeastSquaresState], None],
) -> LeastSquaresState:
    """Fit from an arm that is softer or stiffer as a whole, if it is better.

    Its evaluations are those of everything tried.
    """
    is_stiffness, is_damping = (
        np.array([name.startswith(word) for name in problem.names])
        for word in ("K ", "D ")
    )
    best = first
    for scale in _SCALES:
        x = problem.start.copy()
        # The damping ratio stays.
        x[: len(problem.names)] += math.log(scale) * (is_stiffness + 0.5 * is_damping)
        rows = problem.evaluate(x)
        if rows is not None and problem.share(rows, x) > problem.share(
            best.value, best.x
        ):
            best = LeastSquaresState(x, rows, solver.damping)
    other = least_squares(problem, best.x, solver, state=best, callback=callback)
    spent = solution.evaluations + len(_SCALES) + other.evaluations
    better = max(solution, other, key=lambda one: problem.share(one.value, one.x))
    return dataclasses.replace(better, evaluations=spent)


def _record(
    job: Job, force: Table | None, deviation: Table | None, time: Table | None
) -> CoupledRecord:
    """Record as arrays, refused if it is of another shape."""
    if force is None and deviation is None:
        raise ValueError(
            "Arguments `force` and `deviation` must not both be missing, but are."
        )
    when = np.array(job.path.time if time is None else time, np.float64)
    if when.ndim != 1 or when.size < 12 or not np.all(np.diff(when) > 0):
        raise ValueError(
            "Argument `time` must be at least 12 ascending instants, but has shape "
            f"{when.shape}" + (" or does not ascend." if when.ndim == 1 else ".")
        )

    def rows_of(name: str, values: Table | None) -> np.ndarray | None:
        rows = None if values is None else np.array(values, np.float64)
        if rows is not None and (rows.shape != (when.size, 3) or np.isinf(rows).any()):
            raise ValueError(
                f"Argument `{name}` must have shape ({when.size}, 3), one row per "
                f"instant, and no infinite values, but has shape {rows.shape}."
            )
        return rows

    return CoupledRecord(when, rows_of("force", force), rows_of("deviation", deviation))


def _report(
    problem: _Problem,
    solution: LeastSquaresState,
    max_relative_error: float,
    unfitted: tuple[str, ...],
) -> CoupledFit:
    """Fit with its errors, by name."""
    names, count = problem.names, len(problem.names)
    fit = problem.fit(solution.value)
    C = covariance(solution.value, fit, problem.loss)
    errors, logs = np.sqrt(np.diagonal(C)), solution.x[:count]
    is_fixed = errors[:count] <= max_relative_error
    given = parameter_values(problem.job)
    values = np.array([given[name] for name in names]) * np.exp(logs)
    correlation = correlation_of(C)[:count, :count]
    offset, shift = problem.offset(solution.x), problem.time_shift(solution.x)
    explained = explained_by(problem.measured, fit, offset)
    residual = dict(zip(explained, fit.residual, strict=True))
    known = {name: off[np.isfinite(off)] for name, off in residual.items()}
    return CoupledFit(
        parameters=_by_name(names, np.where(is_fixed, values, math.nan)),
        standard_errors=_by_name(names, np.abs(values) * errors[:count]),
        correlation=correlation,
        covariance=C[:count, :count],
        identifiable=dict(zip(names, is_fixed.tolist(), strict=True)),
        log_scale=logs,
        explained=explained,
        residual_rms={
            name: float(np.sqrt(np.sum(off**2) / max(1, off.size)))
            for name, off in known.items()
        },
        residual=residual,
        offset=offset,
        time_shift=shift or 0.0,
        time_shift_error=0.0 if shift is None else float(errors[-1]),
        has_converged=solution.has_converged,
        simulations=solution.evaluations,
        is_explained=min(explained.values()) >= EXPLAINED,
        notes=(
            *unfitted,
            *coupled_notes(names, is_fixed, correlation, explained, solution),
        ),
        job=scaled_job(problem.job, names, np.where(is_fixed, logs, 0.0)),
    )


def _by_name(names: tuple[str, ...], values: np.ndarray) -> dict[str, float]:
    return dict(zip(names, values.tolist(), strict=True))
