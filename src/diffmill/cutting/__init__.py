"""Cutting forces.

They are mechanistic: per width of an edge, linear in the chip thickness (Altintas) or
a power of it (Kienzle), plus an edge force where there is a chip. Coefficients may
differ from tooth to tooth; `materials` lists published ones.

Assumes that the force follows the chip at once. Chip thickness and the places of the
edges in the stock are those of `process`.
"""

from ._files import material as material, materials as materials
from ._kienzle import KienzleLaw as KienzleLaw
from ._law import AbstractForceLaw as AbstractForceLaw
from ._linear_edge import LinearEdgeLaw as LinearEdgeLaw
