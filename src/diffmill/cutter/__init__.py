"""Milling cutters.

Models the solid that a rotating cutter sweeps, as its intersection with rays along
the axes, and what the force model needs of it: diameter, flutes, helix, flute length.
A `FlatEndMill` stands on its tip, tool +z from tip to shank, and rotates clockwise
seen from the shank.

Assumes a tool axis along +z of the workpiece and flutes that are all alike.
Leaves out ball and bull-nose shapes, run-out, variable pitch and the bottom edges.
"""

from ._cutter import (
    AbstractCutter as AbstractCutter,
    FlatEndMill as FlatEndMill,
    flat_end_mill as flat_end_mill,
)
