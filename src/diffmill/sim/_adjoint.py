"""How a simulation is differentiated through the removal of material.

`Plain` differentiates through the ends of the rays themselves. Every mode of
automatic differentiation works, also for the removed volume and the final stock; but
a tangent of the stock is a second stock, and in reverse mode every step keeps what it
read and scatters into it.

`Traced` treats the stock as a constant. Every end remembers the pose that cut it, and
the derivative of an end with respect to that pose is known in closed form; so a step
carries derivatives from the poses to the samples directly. Both modes of automatic
differentiation work, a step keeps only the ends that its samples read, and no tangent
of the stock exists. Volumes and the final stock have no derivative under `Traced`.
"""

import abc

import equinox as eqx
import jax
from jaxtyping import Array, Float


class AbstractAdjoint(eqx.Module):
    """Which derivatives flow through the stock."""

    @abc.abstractmethod
    def removal_tips(self, tips: Float[Array, "pose 3"]) -> Float[Array, "pose 3"]:
        """Return the tips as removal should see them."""

    @abc.abstractmethod
    def table(self, tips: Float[Array, "pose 3"]) -> Float[Array, "pose 3"] | None:
        """Return the table of poses that samples are tied to, or None."""


class Plain(AbstractAdjoint):
    """Differentiate through the ends of all rays."""

    def removal_tips(self, tips: Float[Array, "pose 3"]) -> Float[Array, "pose 3"]:
        """Return the tips unchanged."""
        return tips

    def table(self, tips: Float[Array, "pose 3"]) -> None:
        """Return None: samples read differentiable ends."""
        del tips


class Traced(AbstractAdjoint):
    """Differentiate through the poses that the ends remember."""

    def removal_tips(self, tips: Float[Array, "pose 3"]) -> Float[Array, "pose 3"]:
        """Return the tips as constants."""
        return jax.lax.stop_gradient(tips)

    def table(self, tips: Float[Array, "pose 3"]) -> Float[Array, "pose 3"]:
        """Return the tips, to which the samples are tied."""
        return tips
