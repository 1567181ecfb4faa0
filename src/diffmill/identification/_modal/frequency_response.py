"""Frequency, damping and stiffness of modes from a measured frequency response."""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from .._statistics.robust_regression import correlation_of
from .mode_model import LARGEST_DAMPING, ModeModel, Quantity, mode_model
from .mode_search import search_modes

Frequencies = Float[Array, " line"] | Float[np.ndarray, " line"]
Response = Complex[Array, " line"] | Complex[np.ndarray, " line"]

# Damping ratios at which the search near given frequencies starts; the best end counts.
_STARTS = (0.003, 0.02, 0.08)
# A number is one if its standard error is below this share of it.
_RELATIVE_ERROR = 0.25
# Share of a line that no fit follows at least: below it there is only rounding.
_LEAST_FREE = 1e-6
# Share of a bound from which on a number is at it.
_AT_BOUND = 0.999


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
        identifiable: Whether stiffness and damping are known to a quarter, and the
            damping is that of a structure, shape (mode,).
        is_structural: Whether the damping ratio stays below the largest that a
            structure has, 0.3, shape (mode,): what does not is no mode.
        explained: Share of the squared response that the modes explain, each line over
            its scatter.
        fitted: The response as fitted, in the measured quantity, shape (line,).
    """

    frequencies: Float[np.ndarray, " mode"]
    damping_ratios: Float[np.ndarray, " mode"]
    stiffness: Float[np.ndarray, " mode"]
    frequency_errors: Float[np.ndarray, " mode"]
    damping_errors: Float[np.ndarray, " mode"]
    stiffness_errors: Float[np.ndarray, " mode"]
    correlation: Float[np.ndarray, "both both"]
    identifiable: Bool[np.ndarray, " mode"]
    is_structural: Bool[np.ndarray, " mode"]
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
        modes: Number of modes; each is then looked for where it explains most.
        frequencies: Guesses [Hz] instead, shape (mode,).
        quantity: "receptance", "mobility" or "accelerance".

    Returns:
        The modes; standard errors take the residual as independent from line to line,
        of whatever size.

    Raises:
        ValueError: Wrong shapes or choices, or too few lines or modes.
    """
    f, H = np.array(frequency, np.float64), np.array(response, np.complex128)
    _check(f, H, modes, frequencies, quantity)
    model = mode_model(f, H, quantity)
    if frequencies is None:
        assert modes is not None
        x = search_modes(model, modes)
        mode_count = x.size // 2
        if mode_count < modes:
            raise ValueError(
                f"The response shows {mode_count} modes, but {modes} are sought; give "
                "their frequencies."
            )
        return _report(x, model)
    guess = np.sort(np.array(frequencies, np.float64))
    ends = [model.refined(guess, np.full(guess.size, zeta)) for zeta in _STARTS]
    return _report(
        min(ends, key=lambda x: float(np.sum(model.residual(x) ** 2))), model
    )


def _report(x: Float[np.ndarray, " both"], model: ModeModel) -> FrequencyResponseFit:
    """Fit of the frequencies and damping ratios x, with its errors."""
    count = x.size // 2
    A, right = model.columns(x), model.rows
    scale = np.linalg.norm(A, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    linear = np.linalg.lstsq(A / scale, right, rcond=None)[0] / scale
    off = right - A @ linear
    # Derivatives by frequencies and ratios at a step far above rounding.
    steps = 1e-6 * np.maximum(np.abs(x), 1e-6)
    slopes = [
        (model.columns(x + s * e) - model.columns(x - s * e)) @ linear / (2 * s)
        for s, e in zip(steps, np.eye(x.size), strict=True)
    ]
    J = np.column_stack([*slopes, A])
    scale = np.linalg.norm(J, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    J = J / scale
    inverse = np.linalg.pinv(J)
    # The weights are a guess, so that each line counts with what is left of it, over
    # the share of it that the fit does not follow (HC3 of MacKinnon and White, Journal
    # of Econometrics 29, 1985); both of its parts scatter alike.
    follows = np.sum(J * inverse.T, axis=1)
    share, square = (v.reshape(2, -1).mean(axis=0) for v in (follows, off**2))
    variance = np.tile(square / np.maximum(1 - share, _LEAST_FREE) ** 2, 2)
    C = (inverse * variance[None]) @ inverse.T
    errors = np.sqrt(np.maximum(np.diagonal(C), 0.0)) / scale
    # The unknown is the static compliance r / omega^2 of the mode.
    c, c_error = linear[:count], errors[2 * count : 3 * count]
    safe = np.where(c != 0, c, 1.0)
    order = np.argsort(x[:count])
    zeta, z_error = x[count:], errors[count : 2 * count]
    is_structural = zeta < _AT_BOUND * LARGEST_DAMPING
    known = (c_error <= _RELATIVE_ERROR * np.abs(c)) & (
        z_error <= _RELATIVE_ERROR * zeta
    )
    both = np.concatenate([order, count + order])
    fitted = (A @ linear).reshape(2, -1) * model.scatter[None]
    return FrequencyResponseFit(
        frequencies=x[:count][order],
        damping_ratios=zeta[order],
        stiffness=np.where(c != 0, 1 / safe, np.inf)[order],
        frequency_errors=errors[:count][order],
        damping_errors=z_error[order],
        stiffness_errors=np.where(c != 0, c_error / safe**2, np.inf)[order],
        correlation=correlation_of(C)[np.ix_(both, both)],
        identifiable=(known & is_structural)[order],
        is_structural=is_structural[order],
        explained=1 - float(off @ off) / max(float(right @ right), 1e-300),
        fitted=fitted[0] + 1j * fitted[1],
    )


def _check(
    f: np.ndarray,
    H: np.ndarray,
    modes: int | None,
    frequencies: np.ndarray | list[float] | None,
    quantity: str,
) -> None:
    """Refuse what is no response or gives no modes."""
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
    if not np.any(H):
        raise ValueError("Argument `response` must differ from zero, but does not.")
