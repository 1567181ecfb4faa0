"""Coefficients from the mean forces of straight cuts at several feeds.

The mean of a force over a revolution is a line in the feed per tooth, whatever the
helix: mean = slope f_z + offset. With h = f_z sin(phi), Altintas, Manufacturing
Automation, 2012, chapter 2 (average force model); in the axes of this package:

    F_x = N a_p / (2 pi) int (-F_t cos - F_r sin) dphi
    F_y = N a_p / (2 pi) int ( F_t sin - F_r cos) dphi
    F_z = N a_p / (2 pi) int F_a dphi,   F_i = K_ic f_z sin(phi) + K_ie

Two slopes give K_tc and K_rc, two offsets K_te and K_re; F_z gives the others.

Of a cutter of radius R teeth go on trochoids, not on circles (`process/_chip.py`), a
face of the stock at the angle b clips the chip, and beside a wall of its own, at 0 or
pi, a tooth rubs along a little longer. To the second order of f_z

    h = f_z sin(phi) + f_z^2 (cos(phi)^2 - N sin(phi) cos(phi) / pi) / (2 R),
    of which the face takes f_z^2 sin(b) |cos(b)| / (2 R) [m rad] at b,
    and the edge forces act over f_z / (2 R) [rad] more at 0 and at pi:

the lines bend, and slopes have a part of the edge forces. With R given both are taken
into account.
"""

import math
from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ...cutting import LinearEdgeLaw
from .identifiability import identifiable, relative_uncertainty

# Order of the coefficients wherever they are a vector.
NAMES = LinearEdgeLaw.NAMES
# Turns in which curvature and line follow from each other, nodes of a quadrature.
_TURNS, _NODES = 4, 32
# Sine of an angle below which a tooth enters or leaves along a wall of its own.
_WALL = 1e-9

FeedValues = Float[Array, " feed"] | Float[np.ndarray, " feed"] | Sequence[float]
FeedRows = (
    Float[Array, "feed 3"] | Float[np.ndarray, "feed 3"] | Sequence[Sequence[float]]
)


class MeanForceFit(eqx.Module):
    """Coefficients from mean forces, with the lines that they are from.

    Attributes:
        coefficients: By name, cutting [Pa] and edge [N/m].
        standard_errors: By name, same units; infinite with only two feeds.
        correlation: Between the coefficients in the order of `NAMES`, shape (6, 6).
        identifiable: By name: whether the force that the standard error makes is small
            beside the mean forces; never with only two feeds.
        slope: Of the three lines [N/m], shape (3,), in feed axes.
        offset: Of the three lines [N], shape (3,).
        curvature: Of the three lines, by trochoids [N/m^2], shape (3,); 0 without a
            radius.
        r_squared: Share of each force's variance that its line explains, shape (3,).
        residual: Measured minus line [N], shape (feed, 3).
    """

    coefficients: dict[str, float]
    standard_errors: dict[str, float]
    correlation: Float[np.ndarray, "6 6"]
    identifiable: dict[str, bool]
    slope: Float[np.ndarray, " 3"]
    offset: Float[np.ndarray, " 3"]
    curvature: Float[np.ndarray, " 3"]
    r_squared: Float[np.ndarray, " 3"]
    residual: Float[np.ndarray, "feed 3"]

    def predicted(self, feed_per_tooth: FeedValues) -> Float[np.ndarray, "feed 3"]:
        """Mean forces of the lines [N].

        Args:
            feed_per_tooth: f_z [m], shape (feed,).
        """
        f = np.array(feed_per_tooth, np.float64)[:, None]
        return self.slope * f + self.curvature * f**2 + self.offset

    @property
    def law(self) -> LinearEdgeLaw:
        """The force law with these coefficients."""
        return LinearEdgeLaw(**self.coefficients)

    def relative_uncertainty(self, columns: Float[np.ndarray, "row 6"]) -> float:
        """Relative error of all coefficients that makes the force as uncertain.

        Args:
            columns: Force per coefficient, shape (row, 6).

        Returns:
            The relative error, infinite if nothing is known.
        """
        return relative_uncertainty(
            self.coefficients, self.standard_errors, self.correlation, columns
        )


def fit_mean_forces(
    feed_per_tooth: FeedValues,
    mean_force: FeedRows,
    *,
    teeth: int,
    axial_depth: float,
    entry_angle: float = 0.0,
    exit_angle: float = math.pi,
    radius: float | None = None,
) -> MeanForceFit:
    """Fit the six coefficients to the mean forces of straight cuts.

    Args:
        feed_per_tooth: f_z of each cut [m], shape (feed,), at least two values.
        mean_force: Mean force on the tool over whole revolutions in feed axes (x along
            the feed, z up the shank) [N], shape (feed, 3).
        teeth: Number of teeth.
        axial_depth: a_p [m].
        entry_angle: Immersion angle at which a tooth enters [rad]; 0 for a slot.
        exit_angle: Immersion angle at which it leaves [rad]; pi for a slot.
        radius: R of the cutter [m]; without it teeth are taken to go on circles.

    Returns:
        The fit.

    Raises:
        ValueError: Wrong shapes, fewer than two different feeds, numbers that are not
            finite, or impossible angles or sizes.
    """
    feeds = np.array(feed_per_tooth, np.float64)
    mean = np.array(mean_force, np.float64)
    _check(feeds, mean, teeth, axial_depth)
    if not 0 <= entry_angle < exit_angle <= math.pi:
        raise ValueError(
            "Arguments `entry_angle` and `exit_angle` must be ascending from 0 to pi, "
            f"but are {entry_angle:g} and {exit_angle:g} rad."
        )
    # Per force a line: unknowns slope and offset, in units of the mean feed.
    unit = float(np.mean(feeds))
    X = np.column_stack([feeds / unit, np.ones_like(feeds)])
    to_slope, to_offset = mean_force_matrices(
        teeth, axial_depth, entry_angle, exit_angle
    )
    bend, rub = np.zeros((2, 3, 3))
    if radius is not None:
        bounds = entry_angle, exit_angle
        bend, rub = _size_matrices(teeth, axial_depth, bounds, radius)
    by_slope, by_offset = np.linalg.inv(to_slope), np.linalg.inv(to_offset)
    # Coefficients from the six numbers (slopes, offsets) of the lines.
    both = np.zeros((6, 6))
    both[:3, :3], both[3:, 3:] = by_slope / unit, by_offset
    both[:3, 3:] = -by_slope @ rub @ by_offset
    line = np.linalg.lstsq(X, mean, rcond=None)[0]
    values = both @ line.reshape(-1)
    curvature = bend @ values[:3]
    # A hundredth of the force: each turn leaves a hundredth of what the one before did.
    for _ in range(_TURNS):
        line = np.linalg.lstsq(X, mean - feeds[:, None] ** 2 * curvature, rcond=None)[0]
        values = both @ line.reshape(-1)
        curvature = bend @ values[:3]
    residual = mean - feeds[:, None] ** 2 * curvature - X @ line
    freedom = len(feeds) - 2
    inverse = np.linalg.inv(X.T @ X)
    if freedom > 0:
        spread = np.sum(residual**2, axis=0) / freedom
        covariance = both @ np.kron(inverse, np.diag(spread)) @ both.T
        errors = np.sqrt(np.diagonal(covariance))
    else:
        covariance, errors = np.eye(6), np.full(6, np.inf)
    per_unit = np.concatenate([np.hstack([f * to_slope, to_offset]) for f in feeds])
    size = np.sqrt(np.mean(per_unit**2, axis=0))
    rms = float(np.sqrt(np.mean(mean**2)))
    is_known = identifiable(np.diag(errors**2), size, rms)
    scale = np.where(np.isfinite(errors) & (errors > 0), errors, 1.0)
    correlation = covariance / scale[:, None] / scale[None]
    around = np.sum((mean - mean.mean(axis=0, keepdims=True)) ** 2, axis=0)
    unexplained = np.sum(residual**2, axis=0) / np.where(around > 0, around, 1.0)
    return MeanForceFit(
        coefficients=by_name(values),
        standard_errors=by_name(errors),
        correlation=correlation,
        identifiable=dict(zip(NAMES, is_known.tolist(), strict=True)),
        slope=line[0] / unit,
        offset=line[1],
        curvature=curvature,
        r_squared=np.where(around > 0, 1 - unexplained, 0.0),
        residual=residual,
    )


def mean_force_matrices(
    teeth: int, axial_depth: float, entry_angle: float, exit_angle: float
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3 3"]]:
    """Mean force per coefficient of a straight cut.

    Args:
        teeth: Number of teeth N.
        axial_depth: a_p [m].
        entry_angle: [rad].
        exit_angle: [rad].

    Returns:
        Slopes of the mean forces F_x, F_y, F_z per K_tc, K_rc, K_ac [m], and offsets
        per K_te, K_re, K_ae [m], each of shape (3, 3).
    """
    a, b = entry_angle, exit_angle
    share = teeth * axial_depth / (2 * math.pi)
    sine, cosine = math.cos(a) - math.cos(b), math.sin(b) - math.sin(a)
    square = (b - a) / 2 - (math.sin(2 * b) - math.sin(2 * a)) / 4
    product = (math.sin(b) ** 2 - math.sin(a) ** 2) / 2
    slope = [[-product, -square, 0.0], [square, -product, 0.0], [0.0, 0.0, sine]]
    offset = [[-cosine, -sine, 0.0], [sine, -cosine, 0.0], [0.0, 0.0, b - a]]
    return share * np.array(slope), share * np.array(offset)


def _size_matrices(
    teeth: int, axial_depth: float, bounds: tuple[float, float], radius: float
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3 3"]]:
    """Mean force that a cutter has by its size, by second orders of the feed.

    Args:
        teeth: Number of teeth N.
        axial_depth: a_p [m].
        bounds: Angles of entry and exit [rad].
        radius: R [m].

    Returns:
        In f_z^2 per K_tc, K_rc, K_ac [-], and in f_z per K_te, K_re, K_ae [-], each of
        shape (3, 3).
    """
    x, weight = np.polynomial.legendre.leggauss(_NODES)
    half = (bounds[1] - bounds[0]) / 2
    phi = bounds[0] + half * (1 + x)
    sin, cos = np.sin(phi), np.cos(phi)
    chip = cos**2 - teeth * sin * cos / math.pi
    bend = half * np.sum(weight * chip * _directions(phi), axis=-1)
    rub = np.zeros((3, 3))
    for bound in bounds:
        own = _directions(np.array([bound]))[..., 0]
        bend = bend - math.sin(bound) * abs(math.cos(bound)) * own
        if abs(math.sin(bound)) < _WALL:
            rub = rub + own
    share = teeth * axial_depth / (2 * math.pi) / (2 * radius)
    return share * bend, share * rub


def _directions(phi: Float[np.ndarray, " angle"]) -> Float[np.ndarray, "3 3 angle"]:
    """Forces along x, y and z per F_t, F_r and F_a [-]."""
    sin, cos = np.sin(phi), np.cos(phi)
    zero, one = np.zeros_like(phi), np.ones_like(phi)
    return np.array([[-cos, -sin, zero], [sin, -cos, zero], [zero, zero, one]])


def by_name(values: Float[np.ndarray, " 6"]) -> dict[str, float]:
    """Six numbers with the names of the coefficients."""
    return {name: float(v) for name, v in zip(NAMES, values, strict=True)}


def _check(
    feeds: np.ndarray,
    mean: np.ndarray,
    teeth: int,
    axial_depth: float,
) -> None:
    """Refuse arguments that give no lines."""
    if feeds.ndim != 1 or mean.shape != (feeds.size, 3):
        raise ValueError(
            "Arguments `feed_per_tooth` and `mean_force` must have shapes (feed,) and "
            f"(feed, 3), but have {feeds.shape} and {mean.shape}."
        )
    if not (np.all(np.isfinite(feeds)) and np.all(np.isfinite(mean))):
        raise ValueError("Feeds and mean forces must be finite, but are not.")
    if len(np.unique(feeds)) < 2 or np.any(feeds <= 0):
        raise ValueError(
            "Argument `feed_per_tooth` must have at least two different values above "
            f"0, but is {feeds.tolist()} m."
        )
    if teeth < 1 or not axial_depth > 0:
        raise ValueError(
            "Arguments `teeth` and `axial_depth` must be positive, but are "
            f"{teeth} and {axial_depth} m."
        )
