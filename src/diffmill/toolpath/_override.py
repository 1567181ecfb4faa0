"""A path travelled with a feed override, on the host."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._types import RealScalarLike
from ._path import SAME_INSTANT, Path
from ._path_feed import Override, PathFeed, checked_override

Rows3 = Float[Array, "row 3"]


def retime(
    path: Path,
    override: Override,
    *,
    acceleration: RealScalarLike | None = None,
    step_count: int | None = None,
) -> Path:
    """Return a path travelled with a feed override, on the host.

    Below 1 the whole motion is slower, its ramps included; above 1 the ramps are as
    steep as the acceleration allows. Rapid moves and rests keep their time.

    Args:
        path: The path as programmed.
        override: One number, or one per knot, the knots equally spaced over the
            length of the path and the override linear between them; positive.
        acceleration: Largest acceleration [m/s^2], as for `PathFeed.of_path`.
        step_count: Rows to return; the tool rests in those after its end. As
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
    places, tips, axes, tool_x = _poses(feed, jnp.asarray(values), count)
    rows = np.ceil(np.asarray(places) - SAME_INSTANT).astype(np.int32)
    start = float(path.time[0])
    return Path(
        time=start + feed.period * np.arange(count),
        positions=np.asarray(tips),
        axes=np.asarray(axes),
        is_rapid=np.asarray(path.is_rapid)[rows],
        line=np.asarray(path.line)[rows],
        tool_x=None if tool_x is None else np.asarray(tool_x),
    )


@eqx.filter_jit
def _poses(
    feed: PathFeed, override: Float[Array, " knot"], step_count: int
) -> tuple[Float[Array, " row"], Rows3, Rows3, Rows3 | None]:
    """Places in rows, tool tips [m], axes and x of the tool at the tooth instants."""
    places = feed.places(override, step_count)
    return places, feed.positions(places), feed.axes(places), feed.tool_x(places)
