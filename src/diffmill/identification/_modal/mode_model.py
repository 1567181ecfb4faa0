"""A frequency response as a sum of modes, every line over its scatter.

Modes of real shape, viscously damped (Ewins, Modal Testing, 2000, chapter 2), with
what modes outside of the band add:

    H(omega) = sum_k c_k omega_k^2 / (omega_k^2 - omega^2 + 2 i zeta_k omega_k omega)
               + u - l / omega^2

c_k, u and l enter linearly and are eliminated in every step (variable projection). An
accelerometer scatters alike in acceleration, so a thousand times more in displacement
at low frequencies; lines are therefore weighed by how much they differ from their
neighbours.
"""

import math
from typing import Literal

import equinox as eqx
import numpy as np
from jaxtyping import Complex, Float

Quantity = Literal["receptance", "mobility", "accelerance"]

# The largest damping ratio of a structure; the joints of an arm reach 0.1.
LARGEST_DAMPING = 0.3
# How far a mode may lie from where it is sought, as shares of that.
_LOWER, _UPPER = 0.8, 1.25
_LEAST_DAMPING = 1e-5
# Lines over which the scatter is taken as one.
_ALIKE = 51


class ModeModel(eqx.Module):
    """Response of a structure and of its modes, real parts, then imaginary ones.

    Attributes:
        omega: Angular frequency of the lines [rad/s], shape (line,).
        factor: Measured quantity per displacement, over the scatter of the line, shape
            (line,).
        scatter: Standard deviation of real and imaginary part, shape (line,).
        rows: The response over its scatter, shape (2 line,).
        outer: Columns of the modes outside of the band, shape (2 line, 2).
    """

    omega: Float[np.ndarray, " line"]
    factor: Complex[np.ndarray, " line"]
    scatter: Float[np.ndarray, " line"]
    rows: Float[np.ndarray, " row"]
    outer: Float[np.ndarray, "row 2"]

    def waves(
        self,
        frequencies: Float[np.ndarray, " mode"],
        ratios: Float[np.ndarray, " mode"],
    ) -> Float[np.ndarray, "row mode"]:
        """Response of modes of unit static compliance."""
        own, omega = 2 * math.pi * frequencies[None], self.omega[:, None]
        below = own**2 - omega**2 + 2j * ratios[None] * own * omega
        return _rows(own**2 / below * self.factor[:, None])

    def columns(self, x: Float[np.ndarray, " both"]) -> Float[np.ndarray, "row column"]:
        """Columns of all linear unknowns: of the modes, then of those outside."""
        half = x.size // 2
        return np.hstack([self.waves(x[:half], x[half:]), self.outer])

    def basis(self, x: Float[np.ndarray, " both"]) -> Float[np.ndarray, "row column"]:
        """Orthonormal basis of these columns."""
        columns = self.columns(x)
        return np.linalg.qr(columns / np.linalg.norm(columns, axis=0)[None])[0]

    def residual(self, x: Float[np.ndarray, " both"]) -> Float[np.ndarray, " row"]:
        """Residual of the response at the best linear unknowns."""
        basis = self.basis(x)
        return self.rows - basis @ (basis.T @ self.rows)

    def refined(
        self,
        frequencies: Float[np.ndarray, " mode"],
        ratios: Float[np.ndarray, " mode"],
    ) -> Float[np.ndarray, " both"]:
        """Frequencies [Hz] and damping ratios with the least residual nearby.

        Args:
            frequencies: Where to start [Hz], shape (mode,); kept to a quarter.
            ratios: Likewise, shape (mode,); kept to what structures have.
        """
        from scipy.optimize import least_squares

        start = np.concatenate([frequencies, ratios])
        least, most = (
            np.concatenate([share * frequencies, np.full(ratios.size, ratio)])
            for share, ratio in ((_LOWER, _LEAST_DAMPING), (_UPPER, LARGEST_DAMPING))
        )
        return least_squares(
            self.residual, start, bounds=(least, most), x_scale=start
        ).x


def mode_model(
    frequency: Float[np.ndarray, " line"],
    response: Complex[np.ndarray, " line"],
    quantity: Quantity,
) -> ModeModel:
    """Model of a measured response.

    Args:
        frequency: [Hz], shape (line,).
        response: In the measured quantity, shape (line,).
        quantity: "receptance", "mobility" or "accelerance".

    Returns:
        The model.
    """
    omega = 2 * math.pi * frequency
    factors = {"receptance": 1.0, "mobility": 1j * omega, "accelerance": -(omega**2)}
    scatter = _scatter(response)
    factor = factors[quantity] / scatter + 0j
    middle = float(np.median(omega))
    outer = np.stack([np.ones_like(omega), -((middle / omega) ** 2)], axis=1)
    return ModeModel(
        omega,
        factor,
        scatter,
        _rows(response / scatter),
        _rows(outer * factor[:, None]),
    )


def _scatter(H: Complex[np.ndarray, " line"]) -> Float[np.ndarray, " line"]:
    """Standard deviation of a part of each line, by its neighbours.

    The median over many lines passes over the few at which a resonance bends. Quieter
    lines than usual get no more weight: there the model is what is off.
    """
    from scipy.ndimage import median_filter

    bend = np.abs(H[:-2] - 2 * H[1:-1] + H[2:])
    # Three independent lines with weights 1, -2, 1; the median of a Rayleigh variable.
    each = bend / math.sqrt(6 * 2 * math.log(2))
    smooth = median_filter(each, min(_ALIKE, each.size), mode="nearest")
    smooth = np.concatenate([smooth[:1], smooth, smooth[-1:]])
    least = max(float(np.median(smooth)), 1e-9 * float(np.abs(H).max()), 1e-300)
    return np.maximum(smooth, least)


def _rows(values: Complex[np.ndarray, "line ..."]) -> Float[np.ndarray, "row ..."]:
    """Complex rows as real ones: the real parts, then the imaginary ones."""
    return np.concatenate([np.real(values), np.imag(values)])
