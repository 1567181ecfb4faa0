"""Frequency, damping and stiffness of modes from a measured frequency response.

Modes of real shape, viscously damped (Ewins, Modal Testing, 2000, chapter 2), with
what modes outside of the band add:

    H(omega) = sum_k r_k / (omega_k^2 - omega^2 + 2 i zeta_k omega_k omega)
               + u - l / omega^2

r_k, u and l enter linearly and are eliminated in every step (variable projection).
"""

import math
from typing import Literal

import equinox as eqx
import numpy as np
from jaxtyping import Array, Complex, Float

from ._linear import correlation_of

Quantity = Literal["receptance", "mobility", "accelerance"]
Frequencies = Float[Array, " line"] | Float[np.ndarray, " line"]
Response = Complex[Array, " line"] | Complex[np.ndarray, " line"]

# Damping ratios at which the search starts; the best end counts.
_STARTS = (0.003, 0.02, 0.08)
# A number is one if its standard error is below this share of it.
_RELATIVE_ERROR = 0.25


class FrequencyResponseFit(eqx.Module):
    """Modes of a frequency response.

    Attributes:
        frequencies: Undamped natural frequencies [Hz], ascending, shape (mode,).
        damping_ratios: zeta [-], shape (mode,).
        stiffness: Modal stiffness omega_k^2 / r_k seen between the two points [N/m];
            negative if they move against each other, shape (mode,).
        frequency_errors: Standard errors [Hz], shape (mode,).
        damping_errors: Standard errors of zeta, shape (mode,).
        stiffness_errors: Standard errors [N/m], shape (mode,).
        correlation: Between the errors of the frequencies, then of zeta, shape
            (2 mode, 2 mode).
        identifiable: Whether stiffness and damping are known to a quarter,
            shape (mode,).
        explained: Share of the squared response that the modes explain.
        fitted: The response as fitted, in the measured quantity, shape (line,).
    """

    frequencies: Float[np.ndarray, " mode"]
    damping_ratios: Float[np.ndarray, " mode"]
    stiffness: Float[np.ndarray, " mode"]
    frequency_errors: Float[np.ndarray, " mode"]
    damping_errors: Float[np.ndarray, " mode"]
    stiffness_errors: Float[np.ndarray, " mode"]
    correlation: Float[np.ndarray, "both both"]
    identifiable: np.ndarray
    explained: float
    fitted: Complex[np.ndarray, " line"]


def fit_frequency_response(
    frequency: Frequencies,
    response: Response,
    *,
    modes: int | None = None,
    frequencies: Float[np.ndarray, " mode"] | list[float] | None = None,
    quantity: Quantity = "receptance",
) -> FrequencyResponseFit:
    """Fit modes to a measured frequency response.

    Args:
        frequency: Lines of the band to fit [Hz], above 0, shape (line,).
        response: Displacement over force [m/N], velocity over force [m/(N s)] or
            acceleration over force [1/kg], shape (line,).
        modes: Number of modes; their frequencies are then taken from the peaks.
        frequencies: Guesses [Hz] instead, shape (mode,).
        quantity: "receptance", "mobility" or "accelerance".

    Returns:
        The modes; standard errors take the residual as independent from line to line.

    Raises:
        ValueError: Wrong shapes or choices, or too few lines or peaks.

    **Differentiability**: runs on the host.
    """
    from scipy.optimize import least_squares

    f, H = np.array(frequency, np.float64), np.array(response, np.complex128)
    guess = _guesses(f, H, modes, frequencies, quantity)
    count = guess.size
    omega = 2 * math.pi * f
    size = max(float(np.sqrt(np.mean(np.abs(H) ** 2))), 1e-300)
    factor = {"receptance": 1.0, "mobility": 1j * omega, "accelerance": -(omega**2)}

    def columns(x: np.ndarray) -> np.ndarray:
        """Return real rows (real parts, then imaginary) per linear unknown."""
        own, zeta = 2 * math.pi * x[:count], x[count:]
        below = own[None] ** 2 - omega[:, None] ** 2
        waves = own[None] ** 2 / (below + 2j * (zeta * own)[None] * omega[:, None])
        middle = float(np.median(omega))
        rest = np.stack([np.ones_like(omega), -((middle / omega) ** 2)], axis=1)
        both = np.hstack([waves, rest.astype(complex)])
        both = both * np.broadcast_to(factor[quantity], omega.shape)[:, None] / size
        return np.vstack([both.real, both.imag])

    right = np.concatenate([H.real, H.imag]) / size

    def residual(x: np.ndarray) -> np.ndarray:
        A = columns(x)
        return A @ _solved(A, right) - right

    bounds = (
        np.concatenate([0.8 * guess, np.full(count, 1e-5)]),
        np.concatenate([1.25 * guess, np.full(count, 0.95)]),
    )
    ends = [
        least_squares(residual, start, bounds=bounds, x_scale=start)
        for zeta in _STARTS
        for start in [np.concatenate([guess, np.full(count, zeta)])]
    ]
    found = min(ends, key=lambda end: end.cost)
    return _report(found.x, columns, right, size)


def _solved(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the least-squares solution, columns scaled."""
    scale = np.linalg.norm(A, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    return np.linalg.lstsq(A / scale, b, rcond=None)[0] / scale


def _report(x: np.ndarray, columns, right: np.ndarray, size: float):
    """Return the fit of the frequencies and damping ratios x."""
    count = x.size // 2
    A = columns(x)
    linear = _solved(A, right)
    off = right - A @ linear
    # Derivatives by frequencies and ratios at a step far above rounding.
    steps = 1e-6 * np.maximum(np.abs(x), 1e-6)
    slopes = [
        (columns(x + s * e) - columns(x - s * e)) @ linear / (2 * s)
        for s, e in zip(steps, np.eye(x.size), strict=True)
    ]
    J = np.column_stack([*slopes, A])
    scale = np.linalg.norm(J, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    freedom = max(1, right.size - J.shape[1])
    C = np.linalg.pinv((J / scale).T @ (J / scale)) * float(off @ off) / freedom
    errors = np.sqrt(np.maximum(np.diagonal(C), 0.0)) / scale
    # The unknown is the static compliance r / omega^2 of the mode.
    c, c_error = linear[:count], errors[2 * count : 3 * count]
    safe = np.where(c != 0, c, 1.0)
    order = np.argsort(x[:count])
    zeta, z_error = x[count:], errors[count : 2 * count]
    known = (c_error <= _RELATIVE_ERROR * np.abs(c)) & (
        z_error <= _RELATIVE_ERROR * zeta
    )
    both = np.concatenate([order, count + order])
    half = right.size // 2
    model = (A @ linear) * size
    return FrequencyResponseFit(
        frequencies=x[:count][order],
        damping_ratios=zeta[order],
        stiffness=np.where(c != 0, 1 / safe, np.inf)[order],
        frequency_errors=errors[:count][order],
        damping_errors=z_error[order],
        stiffness_errors=np.where(c != 0, c_error / safe**2, np.inf)[order],
        correlation=correlation_of(C)[np.ix_(both, both)],
        identifiable=known[order],
        explained=1 - float(off @ off) / max(float(right @ right), 1e-300),
        fitted=model[:half] + 1j * model[half:],
    )


def _guesses(
    f: np.ndarray,
    H: np.ndarray,
    modes: int | None,
    frequencies: np.ndarray | list[float] | None,
    quantity: str,
) -> Float[np.ndarray, " mode"]:
    """Return the frequencies to start from; refuse what gives none."""
    if quantity not in ("receptance", "mobility", "accelerance"):
        raise ValueError(
            'Argument `quantity` must be "receptance", "mobility" or "accelerance", '
            f'but is "{quantity}".'
        )
    if f.ndim != 1 or H.shape != f.shape or not np.all(np.isfinite(H)):
        raise ValueError(
            "Arguments `frequency` and `response` must be finite and of one shape "
            f"(line,), but have {f.shape} and {H.shape}."
        )
    if not np.all(f > 0):
        raise ValueError("Argument `frequency` must be above 0: leave out the line 0.")
    if (modes is None) == (frequencies is None):
        raise ValueError(
            "Exactly one of `modes` and `frequencies` must be given, but "
            f"{'none' if modes is None else 'both'} is."
        )
    count = len(frequencies) if frequencies is not None else int(modes or 0)
    if count < 1 or 2 * f.size < 4 * count + 4:
        raise ValueError(
            f"There must be at least one mode and {2 * count + 2} lines for "
            f"{count} modes, but there are {f.size} lines."
        )
    if frequencies is not None:
        return np.sort(np.array(frequencies, np.float64))
    return spectral_peaks(f, np.abs(H), count)


def spectral_peaks(
    frequency: Float[np.ndarray, " line"],
    amplitude: Float[np.ndarray, " line"],
    count: int,
) -> Float[np.ndarray, " mode"]:
    """Return the frequencies of the most prominent peaks [Hz], ascending.

    Args:
        frequency: [Hz], shape (line,).
        amplitude: In any unit, shape (line,).
        count: Number of peaks.

    Returns:
        The frequencies, shape (count,).

    Raises:
        ValueError: There are fewer peaks.

    **Differentiability**: runs on the host.
    """
    from scipy.signal import find_peaks

    # On a logarithmic scale small modes beside large ones are peaks, too.
    level = np.log(np.maximum(amplitude, 1e-12 * amplitude.max(initial=1e-300)))
    places, found = find_peaks(level, prominence=0.0)
    if places.size < count:
        raise ValueError(
            f"The spectrum has {places.size} peaks, but {count} modes are sought; give "
            "their frequencies."
        )
    best = np.argsort(found["prominences"])[::-1][:count]
    return np.sort(frequency[places[best]])
