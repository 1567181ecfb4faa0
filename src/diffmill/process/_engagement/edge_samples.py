"""Samples of a tool's edges, with the share of their chips that is material."""

import equinox as eqx
from jaxtyping import Array, Float, Int


class EdgeSamples(eqx.Module):
    """Samples of the side edges in one or more sub-steps.

    Attributes:
        angle: Immersion angles [rad], shape (*substep, angle, kept, disc); the axis
            disc has length 1 if all elements share their angles.
        tooth: The tooth of each sample, as `angle`.
        occupancy: Share of the width of an element that has a chip in the stock, 0 to
            1, shape (*substep, angle, kept, element).
        chip_share: Share of the thickness of that chip that lies in the stock, 0 to
            1, as `occupancy`.
    """

    angle: Float[Array, "*substep angle kept disc"]
    tooth: Int[Array, "*substep angle kept disc"]
    occupancy: Float[Array, "*substep angle kept element"]
    chip_share: Float[Array, "*substep angle kept element"]
