"""Pose of a tool: its tip and the direction of its axis."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Shaped


def gathered_rows(
    table: Shaped[Array, "row ..."], at: Int[Array, "..."]
) -> Shaped[Array, "..."]:
    """Some rows of a table, unchecked.

    Args:
        table: The table.
        at: Indices, from 0 to below the number of rows.
    """
    return table.at[at].get(mode="promise_in_bounds", wrap_negative_indices=False)


class Pose(eqx.Module):
    """Position and axis of a tool, or of many.

    Attributes:
        tip: Tool tip in `work` [m], shape (..., 3).
        axis: Unit vector from the tip to the shank, same shape; None where all tools
            stand along +z and nothing needs to be computed for it.
    """

    tip: Float[Array, "*pose 3"]
    axis: Float[Array, "*pose 3"] | None = None

    @classmethod
    def along(
        cls,
        positions: Float[Array, "step 3"],
        axes: Float[Array, "step 3"] | Float[np.ndarray, "step 3"] | None,
    ) -> "Pose":
        """Poses of a path, which is upright without axes."""
        if axes is not None:
            axes = jnp.asarray(axes, positions.dtype)
        return cls(positions, axes)

    def direction(self) -> Float[Array, "*pose 3"]:
        """Unit vector from tip to shank, also where `axis` is None, same shape."""
        if self.axis is not None:
            return self.axis
        up = jnp.asarray([0.0, 0.0, 1.0], self.tip.dtype)
        up = up.reshape((1,) * (self.tip.ndim - 1) + (3,))
        return jnp.broadcast_to(up, self.tip.shape)

    def __getitem__(self, item) -> "Pose":
        """Some of the poses."""
        return jax.tree.map(lambda x: x[item], self)

    def gather(self, at: Int[Array, "*some"]) -> "Pose":
        """Some poses of a table, shape (*some, 3), unchecked.

        Args:
            at: Their indices, from 0 to below the number of poses.
        """
        return jax.tree.map(lambda x: gathered_rows(x, at), self)

    def frozen(self) -> "Pose":
        """Same poses as constants."""
        return jax.tree.map(jax.lax.stop_gradient, self)

    def repeated(self, *counts: int) -> "Pose":
        """One pose, shape (3,), many times, shape (*counts, 3)."""
        return jax.tree.map(
            lambda x: jnp.broadcast_to(x[(None,) * len(counts)], (*counts, 3)), self
        )

    def with_rows(self, first: Array, rows: "Pose") -> "Pose":
        """Table with some rows replaced, from a row on."""
        at = (first, jnp.zeros_like(first))
        return jax.tree.map(
            lambda table, new: jax.lax.dynamic_update_slice(table, new, at), self, rows
        )

    @staticmethod
    @functools.partial(jax.jit, inline=True)
    def frame(axis: Float[Array, "*pose 3"]) -> Float[Array, "*pose 3 3"]:
        """Tool x, y and z as columns; x as near to work x as the axis allows.

        Args:
            axis: Unit vectors from tip to shank, shape (*pose, 3).

        Returns:
            Rotations from tool to `work`, shape (*pose, 3, 3).

        **Differentiability**: smooth but where the axis points along work x: there work
        y takes its place.
        """
        tiny = 1e-12
        along = jnp.asarray([1.0, 0.0, 0.0], axis.dtype)
        other = jnp.asarray([0.0, 1.0, 0.0], axis.dtype)
        is_along = jnp.sum(jax.lax.stop_gradient(axis[..., 1:]) ** 2, -1) < tiny
        start = jnp.where(
            is_along[..., None],
            other.reshape((1,) * (axis.ndim - 1) + (3,)),
            along.reshape((1,) * (axis.ndim - 1) + (3,)),
        )
        x = start - jnp.sum(start * axis, axis=-1, keepdims=True) * axis
        x = x / jnp.linalg.norm(x, axis=-1, keepdims=True)
        return jnp.stack([x, jnp.cross(axis, x), axis], axis=-1)
