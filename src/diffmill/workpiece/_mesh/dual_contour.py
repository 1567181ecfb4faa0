"""The surface of a stock as a closed mesh, by dual contouring.

Every passage of the surface through a cell of the grid gets one vertex, where the
planes through its crossings meet best in the least-squares sense: on an edge or corner
of the part if the planes say so. Every crossed edge of the grid gives two triangles
between the vertices of the four cells around it.

Reference: Ju, Losasso, Schaefer, Warren, Dual contouring of Hermite data, 2002, for the
vertices; the passages are those of a manifold version of it (`cell_loops.py`).
"""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from .cell_loops import edge_number, find_loops
from .hermite import Crossings, find_crossings, inside_nodes
from .mesh import Mesh

if TYPE_CHECKING:
    from .._dexel.stock import Stock

# Along directions that the planes fix less than this, relative to the best fixed one,
# the mean of the crossings stands.
_CUT_OFF = 0.1
# Vertices at a time: bounds the memory.
_CHUNK = 50_000


def surface_mesh(stock: "Stock") -> Mesh:
    """Surface of a stock as a closed mesh, on the host.

    Args:
        stock: The workpiece.

    Returns:
        Triangles [m]. Walls and gaps thinner than the spacing may be lost.

    Raises:
        ValueError: The stock has no material, or the grid is too large for the
            memory.
    """
    inside = inside_nodes(stock)
    if not inside.any():
        raise ValueError(
            "Argument `stock` must hold material at nodes of its grid, but holds none."
        )
    crossings = find_crossings(stock, inside)
    cells, row, loops = find_loops(inside)
    # Loops of the four cells around each crossing, anticlockwise about its axis.
    around = np.stack(
        [
            _loop_of(crossings, row, loops, b, c)
            for b, c in ((1, 1), (0, 1), (0, 0), (1, 0))
        ],
        axis=-1,
    )
    cell_of_loop = np.empty((int(loops.max()) + 1, 3), np.int64)
    at, edge = np.nonzero(loops >= 0)
    cell_of_loop[loops[at, edge]] = cells[at]
    vertices = _vertices(stock, crossings, around, cell_of_loop)
    return Mesh(vertices, _triangles(vertices, around, crossings))


def _loop_of(
    crossings: Crossings,
    row: Int[np.ndarray, "i j k"],
    loops: Int[np.ndarray, "cell 12"],
    b: int,
    c: int,
) -> Int[np.ndarray, " crossing"]:
    """Loop of the cell in which a crossing is the edge at offsets b, c."""
    cell = crossings.edge.copy()
    index = np.arange(len(cell))
    cell[index, (crossings.axis + 1) % 3] -= b
    cell[index, (crossings.axis + 2) % 3] -= c
    edge = np.array([edge_number(axis, b, c) for axis in range(3)])[crossings.axis]
    return loops[row[tuple(cell.T)], edge]


def _vertices(
    stock: "Stock",
    crossings: Crossings,
    around: Int[np.ndarray, "crossing 4"],
    cell_of_loop: Int[np.ndarray, "loop 3"],
) -> Float[np.ndarray, "loop 3"]:
    """Point of each loop that is nearest to the planes of its crossings [m]."""
    loop, count = around.ravel(), len(cell_of_loop)
    points = np.repeat(crossings.points, 4, axis=0)
    normals = np.repeat(crossings.normals, 4, axis=0)

    def total(weights: Float[np.ndarray, " n"]) -> Float[np.ndarray, " loop"]:
        return np.bincount(loop, weights, count)

    size = total(np.ones(len(loop)))
    middle = np.stack([total(points[:, a]) / size for a in range(3)], axis=-1)
    offset = np.einsum("ij,ij->i", normals, points - middle[loop])
    matrix = np.empty((count, 3, 3))
    for a in range(3):
        for b in range(a, 3):
            matrix[:, a, b] = matrix[:, b, a] = total(normals[:, a] * normals[:, b])
    right = np.stack([total(normals[:, a] * offset) for a in range(3)], axis=-1)
    # The grid of cells starts one node before that of the rays.
    lower = np.asarray(stock.origin, np.float64) + (cell_of_loop - 1) * stock.spacing
    given = matrix, right, lower - middle, lower + stock.spacing - middle
    shifts = [
        _least_squares_in_box(*(x[k : k + _CHUNK] for x in given))
        for k in range(0, count, _CHUNK)
    ]
    return middle + np.concatenate(shifts)


def _least_squares_in_box(
    matrix: Float[np.ndarray, "loop 3 3"],
    right: Float[np.ndarray, "loop 3"],
    lower: Float[np.ndarray, "loop 3"],
    upper: Float[np.ndarray, "loop 3"],
) -> Float[np.ndarray, "loop 3"]:
    """Least x with M x = r in the least-squares sense, within bounds.

    A coordinate that leaves its bounds is fixed there, and the others are solved for
    again, so that a vertex next to a sharp edge stays on the faces that meet there.
    """
    largest = np.linalg.eigvalsh(matrix)[:, -1]
    x = np.zeros_like(right)
    is_free = np.ones_like(right, bool)
    pending = np.arange(len(x))
    for _ in range(3):
        free, fixed = is_free[pending], np.where(is_free[pending], 0.0, x[pending])
        residual = right[pending] - np.einsum("lij,lj->li", matrix[pending], fixed)
        part = matrix[pending] * (free[:, :, None] & free[:, None, :])
        values, axes = np.linalg.eigh(part)
        # Eigenvalues are squares of the singular values that the cut-off is about.
        is_fixed = values > _CUT_OFF**2 * largest[pending, None]
        inverse = np.where(is_fixed, 1 / np.where(is_fixed, values, 1.0), 0.0)
        step = np.einsum(
            "lij,lj,lkj,lk->li", axes, inverse, axes, np.where(free, residual, 0.0)
        )
        solution = np.where(free, step, fixed)
        x[pending] = np.clip(solution, lower[pending], upper[pending])
        is_outside = (solution != x[pending]) & free
        is_free[pending] &= ~is_outside
        pending = pending[is_outside.any(axis=1)]
        if not pending.size:
            break
    return x


def _triangles(
    vertices: Float[np.ndarray, "loop 3"],
    around: Int[np.ndarray, "crossing 4"],
    crossings: Crossings,
) -> Int[np.ndarray, "face 3"]:
    """Two triangles for each crossing, split so that they face outward best."""
    quads = np.where(crossings.is_upper[:, None], around, around[:, ::-1])
    splits = (((0, 1, 2), (0, 2, 3)), ((1, 2, 3), (1, 3, 0)))
    facing = []
    for split in splits:
        corners = [vertices[quads[:, list(triangle)]] for triangle in split]
        areas = [np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]) for t in corners]
        out = [np.einsum("ij,ij->i", a, crossings.normals) for a in areas]
        facing.append(np.minimum(out[0], out[1]))
    first, second = (quads[:, np.array(split)] for split in splits)
    is_first = (facing[0] >= facing[1])[:, None, None]
    return np.where(is_first, first, second).reshape(-1, 3)
