"""Samples of a tool's edges, with the share of their chips that is material."""

from collections.abc import Callable

import equinox as eqx
import jax
from jaxtyping import Array, Float, Int, PyTree

from ...workpiece import Pose
from .._chip import RadialDirection


class BottomSamples(eqx.Module):
    """Samples of the bottom edges of an upright flat cutter.

    Attributes:
        outward: Directions of the samples, shape (*substep, angle, tooth).
        tooth: The tooth of each sample, same shape.
        occupancy: 0 to 1, shape (*substep, angle, tooth, annulus).
    """

    outward: RadialDirection
    tooth: Int[Array, "*substep angle tooth"]
    occupancy: Float[Array, "*substep angle tooth annulus"]


class EdgeSamples(eqx.Module):
    """Samples of the edges in one or more sub-steps.

    Attributes:
        angle: Immersion angles [rad], shape (*substep, angle, leading, disc); the axis
            disc has length 1 if all elements share their angles.
        outward: Directions at these angles, same shape.
        tooth: The tooth of each sample, as `angle`.
        occupancy: Share of the width of an element that has a chip in the stock, 0 to
            1, shape (*substep, angle, leading, element).
        chip_share: Share of the thickness of that chip that lies in the stock, 0 to
            1, as `occupancy`.
        bottom: The bottom edges, where they are no elements of their own.
    """

    angle: Float[Array, "*substep angle leading disc"]
    outward: RadialDirection
    tooth: Int[Array, "*substep angle leading disc"]
    occupancy: Float[Array, "*substep angle leading element"]
    chip_share: Float[Array, "*substep angle leading element"]
    bottom: BottomSamples | None = None

    @classmethod
    def at(
        cls,
        angle: Float[Array, "*substep angle leading disc"],
        tooth: Int[Array, "*substep angle leading disc"],
        occupancy: Float[Array, "*substep angle leading element"],
        chip_share: Float[Array, "*substep angle leading element"],
    ) -> "EdgeSamples":
        """Return samples at some angles; arguments as the attributes."""
        return cls(angle, RadialDirection.of(angle), tooth, occupancy, chip_share)

    @property
    def follows_poses(self) -> PyTree[bool]:
        """Flags of the leaves that change with the poses: no angle, no tooth."""
        fixed = jax.tree.map(lambda _: False, self)
        shares = lambda s: (
            s.occupancy,
            s.chip_share,
            *(() if s.bottom is None else (s.bottom.occupancy,)),
        )
        return eqx.tree_at(shares, fixed, replace_fn=lambda _: True)


class Engagement(eqx.Module):
    """Engagement of the teeth in one tooth period.

    Attributes:
        samples: The edges, shape (substep, angle, leading, element).
        decimated: Some older poses, shape (circle, 3).
        sample_jvp: Change of the samples with the poses that are looked up, with those
            of the period before, and with the tip at the start; None if it is not asked
            for.
    """

    samples: EdgeSamples
    decimated: Pose
    sample_jvp: Callable[[Array, Array, Array], EdgeSamples] | None = None
