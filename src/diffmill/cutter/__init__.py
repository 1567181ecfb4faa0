"""Milling cutters.

Models the solid that a rotating end mill sweeps (flat, ball or bull-nose, in any
pose): its signed distance, its normal and its intersection with rays along the axes;
and what the force model needs of it: edge elements from the centre to the shank,
helix, angles between the teeth and run-out. An `EndMill` stands on its tip, tool +z
from tip to shank, and rotates clockwise seen from the shank.

Assumes a cutting part and a shank of one radius, a helix of constant lead, and
run-out as a parallel offset of the tool axis, small beside a chip's arc.
A `ToolHolder` is a stack of cylinders and cones, which is only looked for in stock.
Leaves out tapered and barrel tools.
"""

from ._abstract import (
    AbstractCutter as AbstractCutter,
    EdgeElements as EdgeElements,
)
from ._build import (
    ball_end_mill as ball_end_mill,
    bull_nose as bull_nose,
    flat_end_mill as flat_end_mill,
)
from ._end_mill import EndMill as EndMill
from ._holder import ToolHolder as ToolHolder
