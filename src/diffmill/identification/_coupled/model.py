"""Prediction of a record of a robot that cuts, for scaled parameters.

One coupled simulation with derivatives by the logarithms of the parameters, all of
them at once: forward mode carries a tangent per parameter beside the run, at a part of
its cost, where reverse mode would need a pass per row of the record.
"""

import math
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._job import Job
from ..._result import RESULTS
from ...process import ThroughPoses
from ...sim import JobKinematics, MachiningProblem
from .._cut.cut_model import at_times
from .._statistics.robust_regression import Rows

Table = Float[Array, "..."] | Float[np.ndarray, "..."] | Sequence


class CoupledRecord(eqx.Module):
    """Measurements of a robot that cut, on the clock of the job's path.

    Attributes:
        time: Instants [s], ascending, shape (row,).
        force: On the tool in `work`, mean over the tooth period before each instant
            [N], shape (row, 3); NaN where not measured, None if nowhere.
        deviation: Tip minus desired tip in `work` [m], shape (row, 3); likewise.
    """

    time: Float[np.ndarray, " row"]
    force: Float[np.ndarray, "row 3"] | None
    deviation: Float[np.ndarray, "row 3"] | None


class Modelled(eqx.Module):
    """The simulation of a record and its derivatives, at the tooth instants.

    Attributes:
        force: Mean force of each tooth period [N], shape (step, 3).
        deviation: Tip minus desired tip [m], shape (step, 3).
        force_slopes: By the logarithms [N], shape (step, 3, parameter).
        deviation_slopes: By the logarithms [m], shape (step, 3, parameter).
        result: Outcome of the run.
    """

    force: Float[np.ndarray, "step 3"]
    deviation: Float[np.ndarray, "step 3"]
    force_slopes: Float[np.ndarray, "step 3 parameter"]
    deviation_slopes: Float[np.ndarray, "step 3 parameter"]
    result: RESULTS


def modelled(
    job: Job, places: tuple[int, ...], log_scale: Float[np.ndarray, " parameter"]
) -> Modelled:
    """Simulate a job with scaled parameters, with derivatives.

    The controller compensates the sag, if it does, of the arm as it is: with the
    scaled stiffness.

    Args:
        job: The job, in its precision, with a robot.
        places: Which of `Job.parameter_names` are scaled.
        log_scale: Logarithms of their factors, shape (parameter,).

    Returns:
        Forces and deviations with their derivatives.
    """
    dtype = jnp.dtype(job.simulation.precision)
    values, slopes, result = _run(job, places, jnp.asarray(log_scale, dtype))
    force, deviation, force_slopes, deviation_slopes = (
        np.asarray(one, np.float64) for one in (*values, *slopes)
    )
    return Modelled(force, deviation, force_slopes, deviation_slopes, result)


@eqx.filter_jit
def _run(
    job: Job, places: tuple[int, ...], log_scale: Float[Array, " parameter"]
) -> tuple[tuple[Array, Array], tuple[Array, Array], RESULTS]:
    """Force and deviation of a run, their derivatives, and its outcome."""
    desired = jnp.asarray(job.path.positions)
    joints, is_reached = JobKinematics(job).joints(desired)

    def run(log_scale: Array):
        full = jnp.zeros(len(job.parameter_names), log_scale.dtype)
        scaled = job.with_scaled(full.at[np.array(places)].set(log_scale))
        motors = JobKinematics(scaled).motor_positions_from_joints(joints)
        ran = MachiningProblem.of(scaled, ThroughPoses()).run(motors)
        values = ran.force, ran.actual - desired
        result = RESULTS.where(jnp.all(is_reached), ran.result, RESULTS.unreachable)
        return values, (values, result)

    slopes, (values, result) = jax.jacfwd(run, has_aux=True)(log_scale)
    return values, slopes, result


def parameter_values(job: Job) -> dict[str, float]:
    """Parameters that can be fitted, by name.

    Args:
        job: The job, with a robot.

    Returns:
        Values in SI; of coefficients that differ from tooth to tooth the mean.
    """
    assert job.robot is not None
    names = job.parameter_names[:-1]
    drives = np.concatenate([job.robot.joint_stiffness, job.robot.joint_damping])
    law = [float(np.mean(getattr(job.law, name))) for name in names[len(drives) :]]
    return dict(zip(names, [*drives.tolist(), *law], strict=True))


def scaled_job(
    job: Job, names: tuple[str, ...], log_scale: Float[np.ndarray, " parameter"]
) -> Job:
    """Job with some parameters scaled.

    Args:
        job: The job, with a robot.
        names: Of `Job.parameter_names`.
        log_scale: Logarithms of their factors, shape (parameter,).

    Returns:
        The job.

    Differentiability: smooth.
    """
    everything = job.parameter_names
    full = np.zeros(len(everything))
    full[[everything.index(name) for name in names]] = log_scale
    dtype = jnp.dtype(job.simulation.precision)
    return job.with_scaled(jnp.asarray(full, dtype))


def coupled_rows(
    record: CoupledRecord,
    model: Modelled,
    step: float,
    revolution: float,
    offset: Float[np.ndarray, " 3"] | None,
    shift: float | None,
) -> list[Rows]:
    """Residuals of a record, and their derivatives by all unknowns.

    The unknowns are the logarithms, then the offset of the deviation (if fitted) and
    the time shift (if fitted).

    Args:
        record: The record.
        model: Its simulation.
        step: Tooth period [s].
        revolution: Time of one turn of the spindle [s].
        offset: Constant part of the deviation [m], shape (3,), or None for none.
        shift: Time of the path minus time of the record [s], or None for 0.

    Returns:
        One for the force, one for the deviation, as far as they were measured; the
        `force` of each is measured minus modelled. Instants outside of the path count
        as not measured.
    """
    when = record.time + (shift or 0.0)
    last = step * (len(model.force) - 1)
    is_inside = (when >= 0) & (when <= last * (1 + 1e-12))
    spacing = float(np.median(np.diff(record.time)))
    lag = max(1, round(revolution / spacing))

    def one(
        seen: np.ndarray, values: np.ndarray, slopes: np.ndarray, level: np.ndarray
    ) -> Rows:
        off = seen - at_times(values, 0.0, step, when)
        columns = [at_times(slopes, 0.0, step, when)]
        if offset is not None:
            off = off - (level @ offset)[None]
            columns.append(np.broadcast_to(level[None], (len(when), 3, 3)))
        if shift is not None:
            rate = np.gradient(values, step, axis=0)
            columns.append(at_times(rate, 0.0, step, when)[:, :, None])
        known = np.where(is_inside[:, None], off, math.nan)
        return Rows(np.concatenate(columns, axis=2), known, lag)

    rows = []
    if record.force is not None:
        zero = np.zeros((3, 3))
        rows.append(one(record.force, model.force, model.force_slopes, zero))
    if record.deviation is not None:
        slopes = model.deviation_slopes
        rows.append(one(record.deviation, model.deviation, slopes, np.eye(3)))
    return rows


def mean_over_period(
    time: Table, force: Table, period: float
) -> Float[np.ndarray, "row 3"]:
    """Mean of a measured force over the tooth period before each instant.

    Args:
        time: Instants [s], ascending, shape (row,).
        force: Force at these instants [N], shape (row, 3).
        period: Tooth period [s].

    Returns:
        The mean of straight lines between the instants [N], shape (row, 3); NaN in
        the first period, and where a force within the period is missing.
    """
    when, seen = np.array(time, np.float64), np.array(force, np.float64)
    width, rise = np.diff(when)[:, None], np.diff(seen, axis=0)
    area = width * (seen[1:] + seen[:-1]) / 2
    none = np.zeros((1, seen.shape[1]))
    # A sum would carry a missing force to the end of the record.
    total = np.concatenate([none, np.cumsum(np.nan_to_num(area), axis=0)])
    lost = np.concatenate([none, np.cumsum(np.isnan(area), axis=0)])
    row = np.searchsorted(when, when - period, side="right") - 1
    row = np.clip(row, 0, len(when) - 2)
    after = (when - period - when[row])[:, None]
    begin = total[row] + after * (seen[row] + after / (2 * width[row]) * rise[row])
    is_whole = when - period >= when[0] - 1e-9 * period
    is_known = is_whole[:, None] & (lost == lost[row])
    return np.where(is_known, (total - begin) / period, np.nan)
