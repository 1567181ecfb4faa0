"""Bounds of the machined surface: not too deep, and never out of the cut.

At a point of the ideal surface the machined one may lie below it by no more than the
gouge limit, and above it by no more than nine tenths of the layer that the finishing
pass takes there: so the tool always cuts a tenth of the depth that it is meant to.
"""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ..._moving_rows import step_lengths
from ..._types import FloatRows3
from ...workpiece import Stock
from .._core.problem import Motion
from .._spline.command_limits import InfeasibleLimit, LinearLimits
from .finished_surface import FinishedSurface, wall_depths

# Share of a layer that may be left.
_LEFT_SHARE = 0.9
# A thinner layer is no cut [m].
_LEAST_LAYER = 1e-6
# Rows within this share of a limit stand at it.
_AT_LIMIT = 1e-2

PerPoint = Float[np.ndarray, " point"]


class SurfaceBounds(eqx.Module):
    """Bounds of the machined surface about the ideal one.

    Attributes:
        surface: The ideal surface.
        lower: Deepest errors, negative [m], shape (point,).
        upper: Largest material left [m], shape (point,); infinite where it is free.
        gouge: The gouge limit [m], or infinite.
    """

    surface: FinishedSurface
    lower: PerPoint
    upper: PerPoint
    gouge: float = eqx.field(static=True)

    def errors(self, motion: Motion) -> Float[Array, " point"]:
        """Errors of the surface that a motion leaves [m], shape (point,).

        **Differentiability**: that of `FinishedSurface.errors`.
        """
        return self.surface.errors(motion.actual)

    def excess(self, motion: Motion) -> float:
        """Distance of the worst point to its bounds [m]; 0 if all are within.

        Infinite where the motion is not finite.

        **Differentiability**: none, a host function.
        """
        errors = np.asarray(self.errors(motion), np.float64)
        if not np.all(np.isfinite(errors)):
            return np.inf
        out = np.maximum(self.lower - errors, errors - self.upper)
        return float(np.max(out, initial=0.0))

    @classmethod
    def about(
        cls,
        surface: FinishedSurface,
        *,
        gouge: float = np.inf,
        layers: PerPoint | None = None,
    ) -> "SurfaceBounds":
        """Bounds of a surface.

        Args:
            surface: The ideal surface.
            gouge: Largest depth of a cut into the ideal part [m].
            layers: What `SurfaceBounds.layer_thickness` returned, to stay in the cut;
                None to be free to leave it.

        Raises:
            ValueError: The gouge limit is not positive.

        **Differentiability**: none, a host function.
        """
        if not gouge > 0:
            raise ValueError(f"Argument `gouge` must be above 0, but is {gouge} m.")
        count = len(surface.points)
        upper = np.full(count, np.inf)
        if layers is not None:
            upper = np.where(layers > _LEAST_LAYER, _LEFT_SHARE * layers, np.inf)
        return cls(surface, np.full(count, -float(gouge)), upper, float(gouge))

    @staticmethod
    def layer_thickness(
        surface: FinishedSurface, raw: Stock, desired: FloatRows3
    ) -> PerPoint:
        """Thickness of the layer that the finishing pass takes [m], shape (point,).

        The layer reaches from the point along its normal to where an earlier pass has
        been, or to the raw surface. A pass is earlier if a diameter of travel or more
        lies between it and the first row that comes as deep as the surface.

        Args:
            surface: The ideal surface.
            raw: The stock before the program.
            desired: Tip positions of the program [m], shape (step, 3).

        **Differentiability**: none, a host function.
        """
        tips, R = np.asarray(desired, np.float64), float(surface.radius)
        travel = np.cumsum(step_lengths(tips))
        thickness = _raw_thickness(surface, raw)
        for i, (p, n) in enumerate(zip(surface.points, surface.normals, strict=True)):
            # Distance along n at which each pose begins to cut.
            if surface.is_wall[i]:
                depth = wall_depths(p, n, tips, R)
            else:
                covers = np.hypot(tips[:, 0] - p[0], tips[:, 1] - p[1]) < R
                depth = np.where(covers, tips[:, 2] - p[2], np.inf)
            finishing = int(np.argmax(depth <= depth.min() + 1e-9))
            earlier = depth[travel < travel[finishing] - 2 * R]
            if earlier.size:
                thickness[i] = min(thickness[i], max(float(earlier.min()), 0.0))
        return thickness


def _raw_thickness(surface: FinishedSurface, raw: Stock) -> PerPoint:
    """Thickness of the raw material from each point along its normal [m], (point,)."""
    points, normals = (np.asarray(x) for x in (surface.points, surface.normals))
    origin = np.asarray(raw.origin)
    thickness = np.zeros(len(points))
    for i, (p, n) in enumerate(zip(points, normals, strict=True)):
        axis = int(np.argmax(np.abs(n)))
        ends = np.asarray(raw.families[axis].ends)
        # The top of a wall is half a spacing above its ray.
        place = np.ceil((p - origin) / raw.spacing - 0.5 - 1e-6).astype(int)
        across = place[[(axis + 1) % 3, (axis + 2) % 3]]
        u, v = np.clip(across, 0, np.array(ends.shape[:2]) - 1)
        low, high = ends[u, v]
        slack = 1e-3 * raw.spacing
        holds = (low - slack <= p[axis]) & (p[axis] <= high + slack) & (low < high)
        if np.any(holds):
            slot = int(np.argmax(holds))
            far = high[slot] - p[axis] if n[axis] > 0 else p[axis] - low[slot]
            # Across the layer, if the raw surface is parallel to the ideal one.
            thickness[i] = max(0.0, float(far) * abs(n[axis]))
    return thickness


def refusal(
    bounds: SurfaceBounds,
    errors: Float[np.ndarray, " row"],
    coefficients: Float[np.ndarray, "coefficient axis"],
    max_offset: float,
    limits: Sequence[LinearLimits],
) -> InfeasibleLimit:
    """Error of bounds that cannot be kept: which, where, by how much, what blocks.

    Args:
        bounds: The bounds.
        errors: Errors of the surface at the best command found [m], of one member
            after the other, shape (row,).
        coefficients: Coefficients of that command.
        max_offset: Their bound.
        limits: Their limits.

    **Differentiability**: none, a host function.
    """
    each = errors.reshape(-1, len(bounds.lower))
    deep, left = bounds.lower[None] - each, each - bounds.upper[None]
    is_deep = float(deep.max()) >= float(left.max())
    excess = deep if is_deep else left
    point = int(np.unravel_index(np.argmax(excess), excess.shape)[1])
    most = 1e6 * float(excess.max())
    at = ", ".join(f"{1e3 * x:.2f}" for x in bounds.surface.points[point])
    if is_deep:
        limit = 1e6 * bounds.gouge
        text = (
            f"`gouge` is {limit:.4g} um and cannot be held: the best command found "
            f"cuts {limit + most:.4g} um deep at ({at}) mm, {most:.4g} um too much."
        )
    else:
        room = 1e6 * float(bounds.upper[point])
        text = (
            f"`stay_in_cut` cannot be held: at ({at}) mm the tool leaves "
            f"{room + most:.4g} um of the layer that it is to cut, but may leave "
            f"{room:.4g} um: {most:.4g} um too much."
        )
    return InfeasibleLimit(f"{text} {_blocking(coefficients, max_offset, limits)}")


def _blocking(
    coefficients: np.ndarray, max_offset: float, limits: Sequence[LinearLimits]
) -> str:
    """Sentence about the limits that keep a command from going further."""
    share = 1 - _AT_LIMIT
    blocking = []
    count = int(np.sum(np.abs(coefficients) >= share * max_offset))
    if count:
        blocking.append(f"`max_offset` ({count} of {coefficients.size} coefficients)")
    for limit in limits:
        rows = limit.apply(coefficients)
        count = int(np.sum((rows >= share * limit.upper) & (limit.upper > 0)))
        count += int(np.sum((rows <= share * limit.lower) & (limit.lower < 0)))
        if count:
            blocking.append(f"`{limit.name}` ({count} rows)")
    if not blocking:
        return (
            "No other limit is reached: a closer `knot_spacing`, more `max_steps` or "
            "a stiffer machine may help."
        )
    return f"The best command found reaches {' and '.join(blocking)}."
