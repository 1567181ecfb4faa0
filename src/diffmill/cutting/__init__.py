"""Chip thickness and cutting force.

The near/far-field chip: the chip's inner surface comes analytically from recent tool
positions (circles), and the stock, whose removal lags behind by a travelled distance,
only says where there is material. Forces are mechanistic: per disc and angle, linear
in the chip thickness (Altintas) or a power of it (Kienzle), plus an edge force where
there is a chip. Coefficients may differ from tooth to tooth; `materials` lists
published ones.

Assumes a tool axis along +z, alike teeth, and a chip cut by the side of the tool.
A chip reaches from the innermost earlier circle to the tooth's own; entry and exit are
judged at the outer radius, as in the paper's phi_in and phi_out.
Leaves out the bottom edges, run-out and the paper's point-cloud chip.
"""

from ._chip import (
    circle_chip as circle_chip,
    edge_contact as edge_contact,
    layer_share as layer_share,
    safe_norm as safe_norm,
)
from ._files import (
    material as material,
    material_source as material_source,
    materials as materials,
)
from ._kienzle import KienzleLaw as KienzleLaw
from ._law import AbstractForceLaw as AbstractForceLaw, UninclinedLaw as UninclinedLaw
from ._linear_edge import LinearEdgeLaw as LinearEdgeLaw
