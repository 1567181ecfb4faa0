"""Chip thickness and cutting force.

The near/far-field chip: the chip's inner surface comes analytically from recent tool
positions (circles), and the stock, whose removal lags behind by a travelled distance,
only says where there is material. Forces are mechanistic: per disc and angle, linear
in the chip thickness (Altintas) or a power of it (Kienzle), plus an edge force where
there is a chip. Coefficients may differ from tooth to tooth; `materials` lists
published ones.

Assumes that a chip reaches from the innermost earlier surface to the tooth's own, as
far as that lies in the stock. Where the edges are, what is in the stock, and which
poses came before, is the business of `sim`.
"""

from ._chip import (
    circle_chip as circle_chip,
    edge_contact as edge_contact,
    held_at_rest as held_at_rest,
    layer_share as layer_share,
    safe_norm as safe_norm,
    way_of as way_of,
)
from ._files import (
    material as material,
    material_classes as material_classes,
    material_source as material_source,
    materials as materials,
)
from ._kienzle import KienzleLaw as KienzleLaw
from ._law import AbstractForceLaw as AbstractForceLaw
from ._linear_edge import LinearEdgeLaw as LinearEdgeLaw
