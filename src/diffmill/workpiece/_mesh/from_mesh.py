"""Rays through a closed mesh: where each one enters and leaves the material."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from .._dexel.stock import MARGIN, Rays, Stock, block_grid, check_interval_counts
from .._memory import StockMemory, check_memory
from .mesh import Mesh

if TYPE_CHECKING:
    import manifold3d

# Shorter pieces of material are rounding, as in removal [m].
_SHORTEST = 1e-9
# Slots that cuts need beyond what a raw part holds; a vertical cutter splits no ray
# along z. For a block this gives the slots of `box`.
_ROOM = (7, 7, 0)


def stock_from_mesh(
    mesh: Mesh,
    spacing: float,
    *,
    interval_counts: Sequence[int] | None = None,
    dtype: type | jnp.dtype | None = None,
) -> Stock:
    """Stock of the solid that a closed mesh bounds.

    Args:
        mesh: A closed mesh, all triangles facing outward; shells may overlap.
        spacing: Distance between rays [m].
        interval_counts: Slots for intervals of a ray along x, y and z; by default as
            many as the part needs and seven more along x and y.
        dtype: Floating type; JAX's default if not given.

    Returns:
        The stock, on the grid that `box` gives the box around the mesh.

    Raises:
        ValueError: The spacing is not positive or so large that no ray meets the mesh,
            the slots are too few, the mesh is no solid, or the stock is larger than
            half of the physical memory.
    """
    if not (math.isfinite(spacing) and spacing > 0):
        raise ValueError(
            f"Argument `spacing` must be finite and positive, but is {spacing}."
        )
    if interval_counts is not None:
        check_interval_counts(interval_counts)
    dtype = jnp.zeros(()).dtype if dtype is None else jnp.dtype(dtype)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    smallest = interval_counts or (8, 8, 1)
    memory = Stock.memory_of_block(high - low, spacing, smallest, dtype.itemsize)
    check_memory(memory.needed, f"A stock of spacing {spacing:g} m")
    origin, counts = block_grid(low, high, spacing)
    solid = _solid(mesh)
    pieces = [_cast_family(solid, f, origin, counts, spacing) for f in range(3)]
    needed = [int(np.bincount(ray, minlength=1).max()) for ray, _ in pieces]
    if min(needed) == 0:
        axes = [axis for axis, count in zip("xyz", needed, strict=True) if not count]
        raise ValueError(
            f"Argument `spacing` must be small enough for rays to meet the mesh, but "
            f"at {spacing:g} m no ray along {' and '.join(axes)} does."
        )
    slots = interval_counts
    if slots is None:
        slots = [max(n, 1) + room for n, room in zip(needed, _ROOM, strict=True)]
    if any(n > count for n, count in zip(needed, slots, strict=True)):
        raise ValueError(
            f"Argument `interval_counts` is {slots}, but rays through the mesh have "
            f"up to {tuple(needed)} intervals along x, y and z."
        )
    memory = StockMemory.of_grid(counts.tolist(), slots, dtype.itemsize)
    check_memory(memory.needed, f"A stock of spacing {spacing:g} m")
    families = [
        _rays(
            *pieces[f],
            int(counts[(f + 1) % 3]),
            int(counts[(f + 2) % 3]),
            slots[f],
            dtype,
        )
        for f in range(3)
    ]
    return Stock(
        families=(families[0], families[1], families[2]),
        origin=jnp.asarray(origin, dtype),
        spacing=float(spacing),
        top=float(high[2]),
    )


def _solid(mesh: Mesh) -> "manifold3d.Manifold":
    import manifold3d

    faces = mesh.faces.astype(np.uint64)
    vertices = np.ascontiguousarray(mesh.vertices, np.float64)
    solid = manifold3d.Manifold(manifold3d.Mesh64(vertices, faces))
    if solid.status() != manifold3d.Error.NoError or solid.is_empty():
        raise ValueError(
            "Argument `mesh` must be a closed, oriented surface, but is none "
            f"({solid.status().name})."
        )
    return solid


def _cast_family(
    solid: "manifold3d.Manifold",
    family: int,
    origin: Float[np.ndarray, " 3"],
    counts: Int[np.ndarray, " 3"],
    spacing: float,
) -> tuple[Int[np.ndarray, " piece"], Float[np.ndarray, "piece 2"]]:
    """Pieces of material on all rays of a family.

    Slivers are left out, and pieces that only rounding parts are one.

    Returns:
        The number u * len(v) + v of each piece's ray, ascending, shape (piece,), and
        the ends of the piece [m], shape (piece, 2).
    """
    b, c = (family + 1) % 3, (family + 2) % 3
    start, stop = [0.0] * 3, [0.0] * 3
    start[family] = float(origin[family])
    stop[family] = float(origin[family] + (counts[family] - 1) * spacing)
    numbers, pieces = [], []
    for u in range(MARGIN, counts[b] - MARGIN):
        start[b] = stop[b] = float(origin[b] + u * spacing)
        for v in range(MARGIN, counts[c] - MARGIN):
            start[c] = stop[c] = float(origin[c] + v * spacing)
            for piece in _pieces(solid.ray_cast(start, stop), family):
                numbers.append(u * int(counts[c]) + v)
                pieces.append(piece)
    ray, ends = np.array(numbers, np.int64), np.array(pieces).reshape(-1, 2)
    is_long = ends[:, 1] - ends[:, 0] > _SHORTEST
    ray, ends = ray[is_long], ends[is_long]
    is_next = (ray[1:] == ray[:-1]) & (ends[1:, 0] - ends[:-1, 1] <= _SHORTEST)
    first = np.flatnonzero(np.append(True, ~is_next))[: len(ray)]
    last = np.append(first[1:], len(ray))[: len(first)] - 1
    return ray[first], np.stack([ends[first, 0], ends[last, 1]], axis=-1)


def _pieces(hits: "list[manifold3d.RayHit]", family: int) -> list[tuple[float, float]]:
    """Pieces of material between the hits of one ray [m], in order."""
    pieces, depth, low = [], 0, 0.0
    for hit in hits:
        # Where shells overlap a ray may enter twice before it leaves.
        is_entry = hit.normal[family] < 0
        if is_entry and depth == 0:
            low = hit.position[family]
        depth += 1 if is_entry else -1
        if not is_entry and depth == 0:
            pieces.append((low, hit.position[family]))
    return pieces


def _rays(
    ray: Int[np.ndarray, " piece"],
    piece_ends: Float[np.ndarray, "piece 2"],
    row_count: int,
    column_count: int,
    slot_count: int,
    dtype: jnp.dtype,
) -> Rays:
    """Rays of some pieces, with a fixed number of slots."""
    shape = (row_count, column_count, 2, slot_count)
    ends = np.empty(shape)
    ends[:, :, 0], ends[:, :, 1] = Rays.DEAD, -Rays.DEAD
    # Number of pieces of the same ray before each one.
    slot = np.arange(len(ray)) - np.searchsorted(ray, ray)
    ends[ray // shape[1], ray % shape[1], :, slot] = piece_ends
    return Rays(jnp.asarray(ends, dtype), jnp.full(shape, -1, dtype=jnp.int32))
