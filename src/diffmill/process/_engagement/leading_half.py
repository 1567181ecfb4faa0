"""Teeth that change places at the ends of the leading half turn.

Of an even number of even teeth only the leading half is looked up. Where a tooth enters
this half, the opposite one leaves it, and both touch. They fade to zero there, so that
the change makes no jump. What an edge touches before the half turn and within the fade,
the next samples take over: over samples at any phase the contact W sums to its length,

    W(x) = H(x - 1) + (1 + b) B(x),  B(x) = u^2 (3 - 2 u),  u = 1 - |x - 1|,

x angle steps inside the half; H the integral of a hat of half-width 1, so that B over
samples sums to one; b the steps by which the chip begins before the half turn. The
chip, as thick as x + b there, is taken over in the same way, by

    V(x) = I(x - 1) + (1 + b) H(x - 1) + (1 + b)^2 / 2 B(x),

I the integral of H: x + b from two steps on, and as much as the chip from -b on has if
a sample stands for the way to both neighbours, weighed by a hat.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Shaped

from ...numerics import clamp, hat_integral, ramp
from .._chip import RadialDirection

# A motion per tooth below this has no direction [m].
STILL = 1e-8
# Angle steps over which a sample fades.
_FADE = 0.5


class LeadingSamples(NamedTuple):
    """Samples that can cut, each of shape (substep, angle, leading, element).

    Attributes:
        angle: Immersion angle [rad].
        outward: Its direction.
        tooth: Index of the tooth, in the order of the teeth at the start of a period.
        fade: Weight, less than 1 near the ends of the leading half.
    """

    angle: Float[Array, "substep angle leading element"]
    outward: RadialDirection
    tooth: Int[Array, "substep angle leading element"]
    fade: Float[Array, "substep angle leading element"]


class LeadingTeeth(eqx.Module):
    """The teeth on the leading side, at every sample.

    Attributes:
        place: Which they are, shape (substep, angle, leading, disc).
        count: How many evenly spaced teeth there are.
    """

    place: Int[Array, "substep angle leading disc"]
    count: int = eqx.field(static=True)

    @classmethod
    def by_lead(cls, lead: Float[Array, "substep angle tooth disc"]) -> "LeadingTeeth":
        """Return the half of the teeth, or one more, that leads the most.

        Of an even number it is one of every two that are opposite: to compare them
        costs less than to sort all.

        Args:
            lead: How far each tooth leads, any unit.
        """
        frozen, count = jax.lax.stop_gradient(lead), lead.shape[2]
        if count % 2:
            order = jnp.argsort(frozen, axis=2, descending=True)
            return cls(order[:, :, : (count + 1) // 2].astype(jnp.int32), count)
        half = count // 2
        one = jnp.arange(half, dtype=jnp.int32)[None, None, :, None]
        is_one = frozen[:, :, :half] >= frozen[:, :, half:]
        return cls(jnp.where(is_one, one, one + half), count)

    def of(self, x: Shaped[Array, "substep angle tooth disc"]) -> Shaped[Array, "..."]:
        """Values of these teeth, shape (substep, angle, leading, disc)."""
        if self.count % 2:
            return jnp.take_along_axis(x, self.place, 2)
        half = self.count // 2
        return jnp.where(self.place < half, x[:, :, :half], x[:, :, half:])


def leading_fade(
    lead: Float[Array, "*sample"], angle_step: float
) -> Float[Array, "*sample"]:
    """Return the weight of a sample near the ends of the leading half.

    Args:
        lead: Sine of the angle inside the leading half, any shape.
        angle_step: Angle between two samples [rad].

    Returns:
        0 at and before the end of the half, 1 half an angle step inside, same shape.

    Differentiability: continuously differentiable.
    """
    return _faded(lead / angle_step)


def half_turn_contact_weight(
    lead: Float[Array, "*sample"], angle_step: float, before: Float[Array, ""]
) -> Float[Array, "*sample"]:
    """Return by how much contact counts for contact that is faded or not looked up.

    Args:
        lead: As for `leading_fade`.
        angle_step: Angle between two samples [rad].
        before: Angle by which a chip begins before the leading half [rad], shape ().

    Returns:
        W over the fade and over the contact of an undisturbed cut, same shape.

    Differentiability: continuously differentiable.
    """
    b = before / angle_step
    # At the very end W and the fade are zero, and their ratio is known.
    x = clamp(1e-3, lead / angle_step, 2.0)
    W = hat_integral(x - 1) + (1 + b) * _spread(x)
    return W / (_faded(x) * hat_integral(x + b))


def half_turn_chip_weight(
    lead: Float[Array, "*sample"], angle_step: float, before: Float[Array, ""]
) -> Float[Array, "*sample"]:
    """Return by how much a chip counts for that which is faded or not looked up.

    Arguments and result as of `half_turn_contact_weight`, V over the fade and the
    undisturbed chip.

    Differentiability: continuously differentiable.
    """
    b = before / angle_step
    x = clamp(1e-3, lead / angle_step, 2.0)
    V = ramp(x - 1, 1.0) + (1 + b) * hat_integral(x - 1)
    V = V + ((1 + b) ** 2 / 2) * _spread(x)
    return V / ((x + b) * _faded(x))


def _faded(x: Float[Array, "*sample"]) -> Float[Array, "*sample"]:
    """Return the weight of a sample some angle steps inside the half."""
    return hat_integral(2 * x / _FADE - 1)


def _spread(x: Float[Array, "*sample"]) -> Float[Array, "*sample"]:
    """Return B, which spreads what is taken over onto the next samples."""
    u = clamp(0.0, 1 - jnp.abs(x - 1), 1.0)
    return u**2 * (3 - 2 * u)
