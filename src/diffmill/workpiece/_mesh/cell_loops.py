"""Passages of the surface through the cells of a grid, one vertex for each.

In a cell whose corners are inside and outside, the crossed edges join, face by face,
to closed loops; each loop is one passage of the surface and gets one vertex. On a face
with two inside corners in a diagonal there are two ways to join: either around the
inside corners (the rule) or around the outside ones. Both cells at a face take the same
way, so the surface is closed. Where both segments of such a face would join the same
two loops, four triangles would meet at an edge; there the other way is taken, which
parts a loop in each cell.
"""

import functools

import numpy as np
from jaxtyping import Bool, Int, UInt8

# Corner number 4 x + 2 y + z; edge number 4 axis + 2 b + c with b, c the offsets
# along the axes (axis + 1) % 3 and (axis + 2) % 3.


def edge_number(axis: int, b: int, c: int) -> int:
    """Number of an edge of a cell."""
    return 4 * axis + 2 * b + c


def _corner(axis: int, along: int, b: int, c: int) -> int:
    """Number of the corner at offsets along an axis and the next two."""
    offsets = [0, 0, 0]
    offsets[axis], offsets[(axis + 1) % 3], offsets[(axis + 2) % 3] = along, b, c
    return 4 * offsets[0] + 2 * offsets[1] + offsets[2]


def face_edges(axis: int, side: int) -> tuple[int, int, int, int]:
    """Edges around a face; edge k joins corner k and k + 1 of its ring."""
    b, c = (axis + 1) % 3, (axis + 2) % 3
    # Corners (b, c): 00, 10, 11, 01. An edge along b has offsets (c, axis), one along
    # c has offsets (axis, b).
    return (
        edge_number(b, 0, side),
        edge_number(c, side, 1),
        edge_number(b, 1, side),
        edge_number(c, side, 0),
    )


@functools.cache
def _loops(config: int, flips: int) -> tuple[int, ...]:
    """Loop of each edge of a cell, -1 for edges not crossed.

    Args:
        config: Bit k is 1 if corner k is inside.
        flips: Bit 2 axis + side is 1 if a face joins around outside corners.
    """
    loop = [-1] * 12
    for axis in range(3):
        for b in (0, 1):
            for c in (0, 1):
                ends = (_corner(axis, 0, b, c), _corner(axis, 1, b, c))
                if (config >> ends[0] & 1) != (config >> ends[1] & 1):
                    edge = edge_number(axis, b, c)
                    loop[edge] = edge
    for axis in range(3):
        for side in (0, 1):
            for first, second in _segments(config, flips, axis, side):
                old, new = loop[second], loop[first]
                loop = [new if i == old else i for i in loop]
    numbers = {i: k for k, i in enumerate(sorted({i for i in loop if i >= 0}))}
    return tuple(numbers.get(i, -1) for i in loop)


def _segments(config: int, flips: int, axis: int, side: int) -> list[tuple[int, int]]:
    """Pairs of edges that a face joins."""
    ring = [_corner(axis, side, b, c) for b, c in ((0, 0), (1, 0), (1, 1), (0, 1))]
    is_inside = [bool(config >> corner & 1) for corner in ring]
    edges = face_edges(axis, side)
    crossed = [k for k in range(4) if is_inside[k] != is_inside[(k + 1) % 4]]
    if len(crossed) == 2:
        return [(edges[crossed[0]], edges[crossed[1]])]
    if not crossed:
        return []
    is_flipped = bool(flips >> (2 * axis + side) & 1)
    # Corner k lies between the edges k - 1 and k.
    around = [k for k in range(4) if is_inside[k] != is_flipped]
    return [(edges[k - 1], edges[k]) for k in around]


def loop_table(
    config: Int[np.ndarray, " cell"], flips: Int[np.ndarray, " cell"]
) -> Int[np.ndarray, "cell 12"]:
    """Loop of each edge of each cell, -1 for edges not crossed."""
    keys, index = np.unique(config * 64 + flips, return_inverse=True)
    rows = [_loops(int(key) >> 6, int(key) & 63) for key in keys]
    return np.array(rows, np.int8).reshape(-1, 12)[index.reshape(-1)].astype(np.int64)


def cell_configs(inside: Bool[np.ndarray, "x y z"]) -> UInt8[np.ndarray, "i j k"]:
    """Corners of each cell that are inside, as bits."""
    config = np.zeros([n - 1 for n in inside.shape], np.uint8)
    for corner in range(8):
        view = tuple(
            slice(1, None) if corner >> (2 - a) & 1 else slice(None, -1)
            for a in range(3)
        )
        config |= inside[view].astype(np.uint8) << np.uint8(corner)
    return config


def find_loops(
    inside: Bool[np.ndarray, "x y z"],
) -> tuple[
    Int[np.ndarray, "cell 3"], Int[np.ndarray, "i j k"], Int[np.ndarray, "cell 12"]
]:
    """Cells that the surface passes, and the loops of their edges.

    Args:
        inside: True for nodes in the material; the outermost ones are not.

    Returns:
        The cells, shape (cell, 3); the row of each cell of the grid in that list, -1
        for others, shape (i, j, k); and the loop of each edge of each cell, counted
        over all cells, -1 for edges not crossed, shape (cell, 12).
    """
    configs = cell_configs(inside)
    cells = np.stack(np.nonzero((configs != 0) & (configs != 255)), axis=-1)
    row = np.full(configs.shape, -1, np.int32)
    row[tuple(cells.T)] = np.arange(len(cells))
    config = configs[tuple(cells.T)].astype(np.int64)
    flips = np.zeros(len(cells), np.int64)
    faces = _ambiguous_faces(inside, row)
    while True:
        local = loop_table(config, flips)
        # Every round parts a loop in two cells, so it ends.
        if not _flip_pinched(faces, local, flips):
            break
    counts = local.max(axis=1, initial=-1) + 1
    first = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64)
    return cells, row, np.where(local < 0, -1, local + first[:, None])


def _ambiguous_faces(
    inside: Bool[np.ndarray, "x y z"], row: Int[np.ndarray, "i j k"]
) -> list[Int[np.ndarray, "2 _"]]:
    """Rows of the cells below and above each face with a diagonal.

    Two groups for each axis: faces of one group have no cell in common, so that parting
    a loop at one of them leaves the others as they were.
    """
    faces = []
    for axis in range(3):
        nodes = np.moveaxis(inside, axis, 0)
        s00, s10 = nodes[:, :-1, :-1], nodes[:, 1:, :-1]
        s01, s11 = nodes[:, :-1, 1:], nodes[:, 1:, 1:]
        is_diagonal = (s00 == s11) & (s10 == s01) & (s00 != s10)
        plane, p, q = np.nonzero(is_diagonal)
        rows = np.moveaxis(row, axis, 0)
        for parity in (0, 1):
            pick = plane % 2 == parity
            at = (plane[pick], p[pick], q[pick])
            faces.append(np.stack([rows[at[0] - 1, at[1], at[2]], rows[at]]))
    return faces


def _flip_pinched(
    faces: list[Int[np.ndarray, "2 _"]],
    local: Int[np.ndarray, "cell 12"],
    flips: Int[np.ndarray, " cell"],
) -> bool:
    """Flip, in place, faces whose segments join the same two loops; True if any do."""
    for group, (below, above) in enumerate(faces):
        axis = group // 2
        top = local[below][:, list(face_edges(axis, 1))]
        bottom = local[above][:, list(face_edges(axis, 0))]
        is_pinched = (top == top[:, :1]).all(axis=1)
        is_pinched &= (bottom == bottom[:, :1]).all(axis=1)
        if is_pinched.any():
            flips[below[is_pinched]] ^= 1 << (2 * axis + 1)
            flips[above[is_pinched]] ^= 1 << (2 * axis)
            return True
    return False
