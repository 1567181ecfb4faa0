"""A path travelled with a feed override, on the host."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._types import RealScalarLike
from ._path import Path
from ._path_feed import SAME_INSTANT, Override, PathFeed, checked_override


def retime(
    path: Path,
    override: Override,
    *,
    acceleration: RealScalarLike | None = None,
    step_count: int | None = None,
) -> Path:
    """Return a path travelled with a feed override, on the host.

    Below 1 the whole motion is slower, its ramps included; above 1 the ramps are as
    steep as the acceleration allows. Rapid moves and dwells keep their time.

    Args:
        path: The path as programmed.
        override: One number, or one per knot, the knots equally spaced over the
            length of the path and the override linear between them; positive.
        acceleration: Largest acceleration [m/s^2], as for `PathFeed.of_path`.
        step_count: Rows to return; the tool stands still in those after its end. As
            many as it needs if not given.

    Returns:
        The path with the rows at its tooth instants; 1 everywhere gives the same rows.

    Raises:
        ValueError: If an override is not positive, the rows do not suffice, or there
            are more than a path may have.

    **Differentiability**: none, it runs on the host; see `PathFeed` for what has.
    """
    values = checked_override(override)
    feed = PathFeed.of_path(path, acceleration=acceleration)
    count = feed.row_count(values)
    if step_count is not None and step_count < count:
        raise ValueError(
            f"Argument `step_count` must be at least {count}, but is {step_count}."
        )
    count = step_count or count
    poses = _poses(feed, jnp.asarray(values), count)
    rows = np.ceil(np.asarray(poses.places) - SAME_INSTANT).astype(np.int32)
    start = float(path.time[0])
    return Path(
        time=start + feed.period * np.arange(count),
        positions=np.asarray(poses.tips),
        axes=np.asarray(poses.axes),
        is_rapid=np.asarray(path.is_rapid)[rows],
        line=np.asarray(path.line)[rows],
        tool_x=None if poses.tool_x is None else np.asarray(poses.tool_x),
    )


class _Poses(NamedTuple):
    """Poses at the tooth instants.

    Attributes:
        places: Rows of the path, and parts of a row, shape (row,).
        tips: Tool tips [m], shape (row, 3).
        axes: Tool axes, shape (row, 3).
        tool_x: X of the tool, shape (row, 3); None where the path states none.
    """

    places: Float[Array, " row"]
    tips: Float[Array, "row 3"]
    axes: Float[Array, "row 3"]
    tool_x: Float[Array, "row 3"] | None


@eqx.filter_jit
def _poses(feed: PathFeed, override: Float[Array, " knot"], step_count: int) -> _Poses:
    places = feed.places(override, step_count)
    turned = feed.axes(places), feed.tool_x(places)
    return _Poses(places, feed.positions(places), *turned)
