"""Where a tool stands: its tip and the direction of its axis."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class Pose(eqx.Module):
    """Position and axis of a tool, or of many.

    Attributes:
        tip: Tool tip in `work` [m], shape (..., 3).
        axis: Unit vector from the tip to the shank, same shape; None where all tools
            stand along +z and nothing needs to be computed for it.
    """

    tip: Float[Array, "*pose 3"]
    axis: Float[Array, "*pose 3"] | None = None

    def direction(self) -> Float[Array, "*pose 3"]:
        """Return the axis, also where it is +z and not kept, same shape."""
        if self.axis is not None:
            return self.axis
        up = jnp.asarray([0.0, 0.0, 1.0], self.tip.dtype)
        up = up.reshape((1,) * (self.tip.ndim - 1) + (3,))
        return jnp.broadcast_to(up, self.tip.shape)

    def __getitem__(self, item) -> "Pose":
        """Return some of the poses."""
        return jax.tree.map(lambda x: x[item], self)

    def frozen(self) -> "Pose":
        """Return the same poses as constants."""
        return jax.tree.map(jax.lax.stop_gradient, self)

    def with_row(self, index: Array, row: "Pose") -> "Pose":
        """Return the table with one row replaced."""
        at = (index, jnp.zeros_like(index))
        return jax.tree.map(
            lambda table, new: jax.lax.dynamic_update_slice(table, new[None], at),
            self,
            row,
        )


def repeated(pose: Pose, shape: tuple[int, ...]) -> Pose:
    """Return one pose, shape (3,), many times, shape (*shape, 3)."""
    return jax.tree.map(
        lambda x: jnp.broadcast_to(x[(None,) * len(shape)], (*shape, 3)), pose
    )
