"""Samples of a tool's edges, with the share of their chips that is material."""

from collections.abc import Callable

import equinox as eqx
from jaxtyping import Array, Float, Int

from ...workpiece import Pose


class BottomSamples(eqx.Module):
    """Samples of the bottom edges of an upright flat cutter.

    Attributes:
        angle: Immersion angle of the samples [rad], shape (*substep, angle, tooth).
        tooth: The tooth of each sample, same shape.
        occupancy: 0 to 1, shape (*substep, angle, tooth, annulus).
    """

    angle: Float[Array, "*substep angle tooth"]
    tooth: Int[Array, "*substep angle tooth"]
    occupancy: Float[Array, "*substep angle tooth annulus"]


class EdgeSamples(eqx.Module):
    """Samples of the edges in one or more sub-steps.

    Attributes:
        angle: Immersion angles [rad], shape (*substep, angle, kept, disc); the axis
            disc has length 1 if all elements share their angles.
        tooth: The tooth of each sample, as `angle`.
        occupancy: Share of the width of an element that has a chip in the stock, 0 to
            1, shape (*substep, angle, kept, element).
        chip_share: Share of the thickness of that chip that lies in the stock, 0 to
            1, as `occupancy`.
        bottom: The bottom edges, where they are no elements of their own.
    """

    angle: Float[Array, "*substep angle kept disc"]
    tooth: Int[Array, "*substep angle kept disc"]
    occupancy: Float[Array, "*substep angle kept element"]
    chip_share: Float[Array, "*substep angle kept element"]
    bottom: BottomSamples | None = None


class Engagement(eqx.Module):
    """Engagement of the teeth in one tooth period.

    Attributes:
        samples: The edges, shape (substep, angle, kept, element).
        thinned: Some older poses, shape (circle, 3).
        push: Change of the samples with the poses that are looked up, with those of the
            period before, and with the tip at the start; None if it is not asked for.
    """

    samples: EdgeSamples
    thinned: Pose
    push: Callable[[Array, Array, Array], EdgeSamples] | None = None
