"""Contour error: how far the tool is from the desired path, whenever it gets there."""

import functools
import math
from typing import TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._arrays import is_traced
from .._types import BoolSteps, FloatRows3, FloatSteps

Polyline: TypeAlias = Float[Array, "row 3"] | Float[np.ndarray, "row 3"]


class ContourStatistics(eqx.Module):
    """Mean, root mean square, 95th percentile and maximum of a contour error.

    Attributes:
        mean: Mean size of the error [m].
        rms: Root mean square [m].
        p95: 95 % of the rows have a smaller error [m].
        max: Largest size of the error [m].
    """

    mean: float
    rms: float
    p95: float
    max: float

    @classmethod
    def of(
        cls, error: FloatSteps, weights: FloatSteps | BoolSteps | None = None
    ) -> "ContourStatistics":
        """Statistics of the rows whose weight is above zero.

            mean = sum w |e| / sum w;  rms^2 = sum w e^2 / sum w

        Args:
            error: Contour error e, with or without sign [m], shape (step,).
            weights: Weight w of each row, or whether it counts, shape (step,); None
                counts all rows alike.

        Returns:
            The statistics; NaN where no row counts, or one that does is not finite.

        Raises:
            TypeError: An argument is traced.

        **Differentiability**: runs on the host, not traceable.
        """
        if is_traced((error, weights)):
            raise TypeError(
                "Statistics of a contour error run on the host, but JAX traces it here;"
                " its rms with a derivative is jnp.sqrt(jnp.mean(contour_error**2, "
                "where=is_cutting))."
            )
        size = np.abs(np.asarray(error, np.float64))
        weight = np.ones_like(size) if weights is None else np.asarray(weights, float)
        size, weight = size[weight > 0], weight[weight > 0]
        if not size.size or not np.all(np.isfinite(size)):
            return cls(math.nan, math.nan, math.nan, math.nan)
        return cls(
            mean=float(np.average(size, weights=weight)),
            rms=float(np.sqrt(np.average(size**2, weights=weight))),
            p95=float(np.percentile(size, 95)),
            max=float(size.max()),
        )


def contour_vector(
    actual: FloatRows3, desired: Polyline, *, window: int = 20
) -> Float[Array, "step 3"]:
    """Return the vector from the nearest point of the desired path to the actual one.

    The desired path is the polyline through its rows. Row k of `actual` looks at the
    segments between rows k - window and k + window only, so that another pass of the
    tool over the same place is not mistaken for this one.

    Args:
        actual: Actual tool tips [m], shape (step, 3).
        desired: Desired tool tips [m], shape (row, 3); the path stays at its last row.
        window: Rows to either side that are searched.

    Returns:
        Vectors from the desired path to the actual points [m], shape (step, 3).

    **Differentiability**: smooth within a segment and about a vertex; the choice of
    the segment is held constant, which leaves a kink where two are equally near.
    """
    if window < 1:
        raise ValueError(f"Argument `window` must be at least 1, but is {window}.")
    return _vectors(actual, desired, window)


# One program, not one for each of its operations.
@functools.partial(jax.jit, static_argnames="window")
def _vectors(
    actual: FloatRows3, desired: Polyline, window: int
) -> Float[Array, "step 3"]:
    actual, desired = jnp.asarray(actual), jnp.asarray(desired)
    behind = window + max(0, len(actual) - len(desired))
    padded = jnp.pad(desired, ((window, behind), (0, 0)), mode="edge")
    first = _nearest_segment(
        jax.lax.stop_gradient(actual), jax.lax.stop_gradient(padded), window
    )
    return _from_segment(actual, padded[first], padded[first + 1])


def contour_error(
    actual: FloatRows3,
    desired: Polyline,
    *,
    window: int = 20,
    outward: FloatRows3 | None = None,
) -> Float[Array, " step"]:
    """Return the distance of each actual point to the desired path.

    Args:
        actual: Actual tool tips [m], shape (step, 3).
        desired: Desired tool tips [m], shape (row, 3); the path stays at its last row.
        window: Rows to either side that are searched.
        outward: Directions that count as positive, shape (step, 3); None leaves the
            distances unsigned. A zero row leaves its distance positive.

    Returns:
        Distances [m], shape (step,).

    **Differentiability**: as `contour_vector`; where the distance is zero the
    gradient is set to zero.
    """
    vector = contour_vector(actual, desired, window=window)
    square = jnp.sum(vector * vector, axis=1)
    is_off = square > 0
    # The root has no derivative at zero: it gets a harmless input there.
    distance = jnp.where(is_off, jnp.sqrt(jnp.where(is_off, square, 1.0)), 0.0)
    if outward is None:
        return distance
    side = jnp.sum(jax.lax.stop_gradient(vector) * jnp.asarray(outward), axis=1)
    return jnp.where(side < 0, -distance, distance)


def _from_segment(
    point: Float[Array, "step 3"],
    start: Float[Array, "step 3"],
    end: Float[Array, "step 3"],
) -> Float[Array, "step 3"]:
    """Return the vectors from the nearest points of segments, a dwell being a point."""
    along = end - start
    square = jnp.sum(along * along, axis=1)
    is_segment = square > 0
    fraction = jnp.sum((point - start) * along, axis=1) / jnp.where(
        is_segment, square, 1.0
    )
    # Beside a vertex, as every tip of the desired path is, the slope is that of the
    # segment; `jnp.clip` would halve it there.
    fraction = jnp.where(fraction < 0, 0.0, jnp.where(fraction > 1, 1.0, fraction))
    return point - start - fraction[:, None] * along


def _nearest_segment(
    actual: Float[Array, "step 3"], padded: Float[Array, "row 3"], window: int
):
    """Return for each step the row of `padded` at which its nearest segment begins.

    A scan over the offsets holds one candidate per step at a time, so that memory
    grows with the path only and not with the window.
    """
    count = actual.shape[0]

    def nearer(best, offset):
        start = jax.lax.dynamic_slice_in_dim(padded, offset, count)
        end = jax.lax.dynamic_slice_in_dim(padded, offset + 1, count)
        vector = _from_segment(actual, start, end)
        square = jnp.sum(vector * vector, axis=1)
        is_nearer = square < best[0]
        return (
            jnp.where(is_nearer, square, best[0]),
            jnp.where(is_nearer, offset, best[1]),
        ), None

    start = (jnp.full((count,), jnp.inf, actual.dtype), jnp.zeros((count,), jnp.int32))
    offsets = jnp.arange(2 * window, dtype=jnp.int32)
    (_, offset), _ = jax.lax.scan(nearer, start, offsets)
    return jnp.arange(count, dtype=jnp.int32) + offset
