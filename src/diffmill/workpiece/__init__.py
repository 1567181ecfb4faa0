"""The workpiece as a tri-dexel stock.

Three orthogonal families of rays (along x, y and z of `work`) with the same spacing;
each ray holds a fixed number of intervals of material in unsorted slots, and each end
of an interval remembers when a tooth cut it. Removal subtracts the tool in a window
of rays; the signed distance of a point combines what the three families see.

Assumes a grid along the axes of `work`. A ray that needs
more intervals than it has slots sets a flag; it never drops material silently.
A stock may come from a mesh or from the result of an earlier run, leaves as a closed
mesh with its sharp edges, and can be compared with an ideal one point by point. Files
are read and written in `_files.py` alone.
"""

from ._dexel.dexel_cloud import RemovedPieces as RemovedPieces
from ._dexel.interval import CutInterval as CutInterval
from ._dexel.occupancy import Discs as Discs
from ._dexel.occupancy_in_space import occupancy_in_space as occupancy_in_space
from ._dexel.removal import RemovalWindow as RemovalWindow
from ._dexel.stock import (
    Rays as Rays,
    Stock as Stock,
    StockPieces as StockPieces,
    box as box,
)
from ._dexel.tooth_pass import (
    PoseTrack as PoseTrack,
    ToothPass as ToothPass,
)
from ._files import (
    StockFileError as StockFileError,
    from_mesh as from_mesh,
    load_stock as load_stock,
    save as save,
)
from ._mesh.mesh import Mesh as Mesh
from ._mesh.surface_error import (
    SurfaceError as SurfaceError,
)
from ._pose import Pose as Pose
