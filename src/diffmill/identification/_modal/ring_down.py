"""Damping of the joints: modes from ring-downs, joints from modes.

A ring-down is a sum of decaying cosines; frequency f and damping ratio zeta of each
are fitted by least squares, their amplitudes being linear. For small damping,
2 zeta_k omega_k = phi_k^T D phi_k with mode shapes phi_k of unit modal mass: linear in
the joints' dampers D_i, which cannot be negative.
"""

import math
from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float

from ...robot import Robot, mode_shapes
from .._statistics.grouped_nnls import fit_groups
from .._statistics.robust_regression import correlation_of
from .mode_model import LARGEST_DAMPING

Values = Float[Array, "..."] | Float[np.ndarray, "..."] | Sequence

# A damper or a ratio is a number if its standard error is below this share of it.
_RELATIVE_ERROR = 0.25
# Lines of a spectrum per sample: peaks between the lines are not missed.
_PADDING = 4


class RingDownFit(eqx.Module):
    """Modes of a ring-down.

    Attributes:
        frequencies: Undamped natural frequencies [Hz], ascending, shape (mode,).
        damping_ratios: zeta [-], shape (mode,).
        frequency_errors: Standard errors [Hz], shape (mode,).
        damping_errors: Standard errors of zeta, shape (mode,).
        correlation: Between the errors of the frequencies, then of zeta, shape
            (2 mode, 2 mode).
        identifiable: Whether the damping ratio is known to a quarter, and is that of
            a structure, at most 0.3, shape (mode,).
        is_structural: The latter alone: what is damped more is no mode, shape (mode,).
        explained: Share of the signal's square that the modes explain.
        fitted: The signal as fitted, shape (sample,).
    """

    frequencies: Float[np.ndarray, " mode"]
    damping_ratios: Float[np.ndarray, " mode"]
    frequency_errors: Float[np.ndarray, " mode"]
    damping_errors: Float[np.ndarray, " mode"]
    correlation: Float[np.ndarray, "both both"]
    identifiable: Bool[np.ndarray, " mode"]
    is_structural: Bool[np.ndarray, " mode"]
    explained: float
    fitted: Float[np.ndarray, " sample"]


class JointDampingFit(eqx.Module):
    """Dampers of the joints.

    Attributes:
        damping: D [N m s/rad or N s/m], shape (joint,); NaN where not identifiable.
        standard_errors: Same unit and shape; NaN likewise.
        correlation: Between the errors, shape (joint, joint); NaN where nothing is
            known.
        identifiable: Whether the modes fix the damper, shape (joint,).
        outliers: Modes that contradict the others, as indices (pose, mode).
    """

    damping: Float[np.ndarray, " joint"]
    standard_errors: Float[np.ndarray, " joint"]
    correlation: Float[np.ndarray, "joint joint"]
    identifiable: Bool[np.ndarray, " joint"]
    outliers: tuple[tuple[int, int], ...] = eqx.field(static=True)


def fit_ring_down(time: Values, signal: Values, frequencies: Values) -> RingDownFit:
    """Fit decaying cosines to a free vibration.

    Args:
        time: Instants [s], shape (sample,).
        signal: Displacement or acceleration in any unit, shape (sample,), without its
            mean.
        frequencies: Guesses of the modes' frequencies [Hz], shape (mode,), near the
            peaks of the spectrum.

    Returns:
        The modes; the standard errors take the residual as independent.

    Raises:
        ValueError: Wrong shapes, fewer samples than unknowns, numbers that are not
            finite, a signal that does not vary, or guesses that are not above 0.
    """
    from scipy.optimize import least_squares

    t, y = np.array(time, np.float64), np.array(signal, np.float64)
    guess = np.sort(np.array(frequencies, np.float64))
    count = guess.size
    _check(t, y, count)
    if guess.ndim != 1 or not np.all((guess > 0) & np.isfinite(guess)):
        raise ValueError(
            "Argument `frequencies` must have shape (mode,) and be above 0 and finite, "
            f"but is {guess.tolist()}."
        )
    t = t - t[0]

    def waves(x: np.ndarray) -> np.ndarray:
        omega, zeta = 2 * math.pi * x[:count], x[count:]
        decay = np.exp(-t[:, None] * (zeta * omega)[None])
        turn = t[:, None] * (omega * np.sqrt(1 - zeta**2))[None]
        return np.hstack([decay * np.cos(turn), decay * np.sin(turn)])

    def residual(x: np.ndarray) -> np.ndarray:
        A = waves(x)
        return A @ np.linalg.lstsq(A, y, rcond=None)[0] - y

    start = np.concatenate([guess, np.full(count, 0.02)])
    bounds = (
        np.concatenate([0.7 * guess, np.zeros(count)]),
        np.concatenate([1.4 * guess, np.full(count, 0.9)]),
    )
    solution = least_squares(residual, start, bounds=bounds, x_scale=start)
    freedom = t.size - 4 * count
    spread = float(np.sum(solution.fun**2)) / freedom
    C = spread * np.linalg.pinv(solution.jac.T @ solution.jac)
    errors = np.sqrt(np.diagonal(C))
    order = np.argsort(solution.x[:count])
    both = np.concatenate([order, count + order])
    zeta, z_error = solution.x[count:][order], errors[count:][order]
    is_structural = zeta <= LARGEST_DAMPING
    total = max(float(np.sum(y**2)), 1e-300)
    return RingDownFit(
        frequencies=solution.x[:count][order],
        damping_ratios=zeta,
        frequency_errors=errors[:count][order],
        damping_errors=z_error,
        correlation=correlation_of(C)[np.ix_(both, both)],
        identifiable=is_structural & (z_error <= _RELATIVE_ERROR * zeta),
        is_structural=is_structural,
        explained=1 - float(np.sum(solution.fun**2)) / total,
        fitted=y + solution.fun,
    )


def ring_down_frequencies(
    time: Values, signal: Values, count: int
) -> Float[np.ndarray, " mode"]:
    """Guesses of the frequencies in a free vibration [Hz], shape (mode,).

    The largest line of the spectrum is fitted, then the largest of what that leaves,
    and so on: a damped mode beside a sharp one has no peak of its own before.

    Args:
        time: Instants [s], shape (sample,), evenly spaced but for gaps.
        signal: Shape (sample,), without its mean.
        count: Number of modes.

    Returns:
        Frequencies [Hz], ascending, shape (count,).

    Raises:
        ValueError: As `fit_ring_down`.
    """
    t, y = np.array(time, np.float64), np.array(signal, np.float64)
    _check(t, y, count)
    step = float(np.median(np.diff(t)))
    grid = np.arange(t[0], t[-1], step)
    lines = np.fft.rfftfreq(_PADDING * grid.size, step)
    # Less than a period in the record is drift.
    is_wave = lines > 1.0 / float(t[-1] - t[0])
    frequencies, residual = np.zeros(0), y
    for _ in range(count):
        size = np.abs(np.fft.rfft(np.interp(grid, t, residual), _PADDING * grid.size))
        peak = lines[int(np.argmax(np.where(is_wave, size, 0.0)))]
        fit = fit_ring_down(t, y, np.append(frequencies, peak))
        frequencies, residual = fit.frequencies, y - fit.fitted
    return frequencies


def _check(t: np.ndarray, y: np.ndarray, count: int) -> None:
    """Refuse what is no signal, or too short a one for some modes."""
    if t.ndim != 1 or y.shape != t.shape or t.size <= 4 * count:
        raise ValueError(
            "Arguments `time` and `signal` must have one shape (sample,) with more "
            f"than 4 samples per mode, but have {t.shape} and {y.shape} for {count} "
            "modes."
        )
    for name, values in (("time", t), ("signal", y)):
        if not np.all(np.isfinite(values)):
            row = int(np.argmin(np.isfinite(values)))
            raise ValueError(
                f"Argument `{name}` must be finite, but sample {row} is {values[row]}."
            )
    if np.ptp(y) == 0:
        raise ValueError(
            f"Argument `signal` must vary, but is {y[0]:g} in all samples."
        )


def fit_joint_damping(
    robot: Robot,
    q: Values,
    damping_ratios: Values,
    *,
    max_relative_error: float = _RELATIVE_ERROR,
) -> JointDampingFit:
    """Fit the joints' dampers to the damping ratios of modes in several poses.

    Args:
        robot: The robot with its masses and its joint stiffness.
        q: Joint positions [rad or m], shape (pose, joint).
        damping_ratios: zeta of the robot's modes, the lowest first [-], shape
            (pose, mode) with at most as many modes as joints; NaN where not measured.
        max_relative_error: A damper is given if its relative standard error is at
            most this.

    Returns:
        The fit.

    Raises:
        ValueError: Wrong shapes.
    """
    poses, ratios = np.array(q, np.float64), np.array(damping_ratios, np.float64)
    joints = robot.joint_count
    if poses.ndim != 2 or poses.shape[1] != joints:
        raise ValueError(
            f"Argument `q` must have shape (pose, {joints}), but has {poses.shape}."
        )
    if ratios.ndim != 2 or len(ratios) != len(poses) or ratios.shape[1] > joints:
        raise ValueError(
            f"Argument `damping_ratios` must have shape ({len(poses)}, mode) with at "
            f"most {joints} modes, but has {ratios.shape}."
        )
    columns, values, places = [], [], []
    for i, (pose, zetas) in enumerate(zip(poses, ratios, strict=True)):
        modes = mode_shapes(robot, pose)
        shapes = np.asarray(modes.joint_shapes, np.float64)
        omega = 2 * math.pi * np.asarray(modes.frequencies, np.float64)
        for k in np.flatnonzero(np.isfinite(zetas)):
            columns.append(shapes[k] ** 2 / (2 * omega[k]))
            values.append(zetas[k])
            places.append((i, int(k)))
    fit = fit_groups(np.stack(columns)[:, None], np.array(values)[:, None])
    D, errors = fit.x, np.sqrt(np.diagonal(fit.covariance))
    is_fixed = (D > 0) & (errors <= max_relative_error * D)
    return JointDampingFit(
        damping=np.where(is_fixed, D, np.nan),
        standard_errors=np.where(is_fixed, errors, np.nan),
        correlation=correlation_of(fit.covariance),
        identifiable=is_fixed,
        outliers=tuple(places[i] for i in np.flatnonzero(fit.is_outlier)),
    )
