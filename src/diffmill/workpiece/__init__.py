"""The workpiece as a tri-dexel stock.

Three orthogonal families of rays (along x, y and z of `work`) with the same spacing;
each ray holds a fixed number of intervals of material in unsorted slots, and each end
of an interval remembers which tool pose cut it. Removal subtracts the tool in a window
of rays; the signed distance of a point combines what the three families see.

Assumes a block as raw stock and a grid along the axes of `work`. A ray that needs
more intervals than it has slots sets a flag; it never drops material silently.
Leaves out stock from meshes or earlier runs and export as a mesh.
"""

from ._occupancy import Discs as Discs, occupancy as occupancy
from ._removal import (
    RemovalWindow as RemovalWindow,
    removal_window as removal_window,
    remove_poses as remove_poses,
    subtract as subtract,
)
from ._stock import (
    Rays as Rays,
    Stock as Stock,
    box as box,
    grid_shape as grid_shape,
    has_material_above as has_material_above,
    height_map as height_map,
    ray_ends as ray_ends,
)
