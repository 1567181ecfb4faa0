"""A command that is carried out late, as a controller or its interface does it."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._types import FloatRows, RealScalarLike


def delayed(
    command: FloatRows,
    delay: RealScalarLike,
    time_step: RealScalarLike,
    *,
    nominal: FloatRows | None = None,
) -> Float[Array, "step axis"]:
    """Command that comes late, shape (step, axis); before it, the first row stands.

    Between two rows a command moves linearly, as the simulation takes it.

    Args:
        command: The command, shape (step, axis).
        delay: Delay between the command and the motion it asks for [s], at least 0.
        time_step: Time between two rows [s].
        nominal: Where given, only the offset from it is late, as where a controller
            runs the program and takes corrections from outside, shape (step, axis).

    Returns:
        The late command, shape (step, axis).

    **Differentiability**: linear in the command; in the delay, kinks at multiples of
    the time step.
    """
    rows = jnp.asarray(command)
    if nominal is not None:
        base = jnp.asarray(nominal, rows.dtype)
        return base + delayed(rows - base, delay, time_step)
    late = jnp.asarray(delay, rows.dtype) / jnp.asarray(time_step, rows.dtype)
    place = jnp.maximum(jnp.asarray(np.arange(len(rows)), rows.dtype) - late, 0)
    first = jnp.minimum(jnp.floor(place).astype(jnp.int32), len(rows) - 2)
    share = (place - first.astype(rows.dtype))[:, None]
    return (1 - share) * rows[first] + share * rows[first + 1]
