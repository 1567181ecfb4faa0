"""Surface error: signed distance from the ideal surface at every ray end.

The ends of the machined stock are points on its surface, exact to rounding. The ideal
stock becomes a mesh, and each point gets its distance to the nearest triangle, whatever
way the surface faces there: walls, floors and slopes are treated alike. The sign comes
from the sum of the normals of the triangles at the nearest place, weighted by their
angles, which is right at edges and corners too.

The measure goes one way: a rib of the ideal that was cut off altogether shows only in
the points of what was left of it.

Reference: Baerentzen, Aanaes, Signed distance computation using the angle weighted
pseudonormal, 2005, for the sign.
"""

import math

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from .._dexel.stock import Stock
from .mesh import Mesh

# Triangles of the mesh are about one spacing large: the nearest is among these.
_CANDIDATES = 24
# Points at a time: bounds the memory.
_CHUNK = 20_000


class SurfaceMeasures(eqx.Module):
    """Figures of a surface error, walls and floors apart; NaN where there is none.

    Attributes:
        wall_mean: Mean signed error of the walls [m], positive: material left.
        wall_rms: Root mean square error of the walls [m].
        wall_p95: 95 % of the walls' points are closer to the ideal surface [m].
        floor_mean: As `wall_mean`, of the floors [m].
        floor_rms: As `wall_rms` [m].
        floor_p95: As `wall_p95` [m].
        deepest: How far the tool cut into the ideal part at most [m], at least 0.
    """

    wall_mean: float
    wall_rms: float
    wall_p95: float
    floor_mean: float
    floor_rms: float
    floor_p95: float
    deepest: float


class SurfaceError(eqx.Module):
    """Signed distance of a machined surface from the ideal one, on the host.

    Attributes:
        points: Points on the machined surface [m], shape (n, 3).
        error: Distance to the ideal surface [m], positive where material was left
            standing, negative where too much was cut, shape (n,).
        normal: Outward unit normal of the ideal surface at its nearest place,
            shape (n, 3).
        is_floor: Whether that normal is within 45 degrees of the z axis (floors, tops
            and undersides), else a wall, shape (n,).
        is_cut: Whether a tool pose cut the point; False on raw faces, shape (n,).
        family: Axis of the ray that found the point, shape (n,).
    """

    points: Float[np.ndarray, "n 3"]
    error: Float[np.ndarray, " n"]
    normal: Float[np.ndarray, "n 3"]
    is_floor: Bool[np.ndarray, " n"]
    is_cut: Bool[np.ndarray, " n"]
    family: Int[np.ndarray, " n"]

    @property
    def area_share(self) -> Float[np.ndarray, " n"]:
        """Return the share of the surface that each point stands for, shape (n,).

        A plane is met by |n_x| + |n_y| + |n_z| rays per square of the spacing.
        """
        share = 1 / np.abs(self.normal).sum(axis=1)
        return share / share.sum()

    def measures(self) -> SurfaceMeasures:
        """Return the figures of the points that a tool cut."""
        error, is_floor = self.error[self.is_cut], self.is_floor[self.is_cut]
        wall, floor = error[~is_floor], error[is_floor]
        return SurfaceMeasures(
            wall_mean=_mean(wall),
            wall_rms=math.sqrt(_mean(wall**2)),
            wall_p95=_p95(wall),
            floor_mean=_mean(floor),
            floor_rms=math.sqrt(_mean(floor**2)),
            floor_p95=_p95(floor),
            deepest=float(max(0.0, -error.min(initial=0.0))),
        )


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if values.size else math.nan


def _p95(values: np.ndarray) -> float:
    return float(np.percentile(np.abs(values), 95)) if values.size else math.nan


def surface_error(
    machined: Stock, ideal: Stock, *, leaves_out_raw: bool = False
) -> SurfaceError:
    """Return how far every ray end of a machined stock is from the ideal surface.

    Args:
        machined: The stock as it was cut.
        ideal: The stock as it should be, for example cut by the desired path, or from
            a mesh of the part; its grid may be another one.
        leaves_out_raw: Whether points that no tool cut, and that the ideal stock has
            too, are left out.

    Returns:
        One row for each end of each ray of all three families; none if the machined
        stock holds no material. Against planes the
        distance is exact to rounding. Where the ideal surface is curved with radius r,
        its mesh is off by up to about 0.4 spacing^2 / r, and along sharp edges oblique
        to all axes by a part of the spacing.

    Raises:
        ValueError: The ideal stock holds no material.
    """
    found = [machined.ray_ends(f)[0] for f in range(3)]
    points = np.concatenate(found)
    if not bool(ideal.volume() > 0):
        raise ValueError("Argument `ideal` must hold material, but is empty.")
    is_cut = np.concatenate([_end_poses(machined, f) >= 0 for f in range(3)])
    family = np.repeat(np.arange(3), [len(p) for p in found])
    bound = _end_distance(ideal, points)
    if leaves_out_raw:
        kept = is_cut | (bound > 0)
        points, is_cut, family, bound = (
            rows[kept] for rows in (points, is_cut, family, bound)
        )
    error, normal = signed_distance(ideal.to_mesh(), points)
    return SurfaceError(
        points=points,
        error=np.copysign(np.minimum(np.abs(error), bound), error),
        normal=normal,
        is_floor=np.abs(normal[:, 2]) > np.sqrt(0.5),
        is_cut=is_cut,
        family=family,
    )


def _end_distance(
    stock: Stock, points: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, " n"]:
    """Return the distance to the nearest ray end, a bound of that to the surface.

    A film thinner than the spacing, as a cut along the border leaves it, is lost in
    the mesh; its ends still say where it is.
    """
    from scipy.spatial import KDTree

    tree = KDTree(np.concatenate([stock.ray_ends(f)[0] for f in range(3)]))
    return np.asarray(tree.query(points)[0], np.float64)


def _end_poses(stock: Stock, family: int) -> Int[np.ndarray, " end"]:
    """Return the poses of the ends in the order of `Stock.ray_ends`."""
    rays = stock.families[family]
    ends = np.asarray(rays.ends)
    is_live = np.broadcast_to((ends[:, :, 1] > ends[:, :, 0])[:, :, None], ends.shape)
    return np.asarray(rays.poses)[is_live]


def signed_distance(
    mesh: Mesh, points: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Return the distance of points to a closed mesh of small, like triangles.

    Args:
        mesh: The mesh, as `Stock.to_mesh` makes it.
        points: The points [m], shape (n, 3).

    Returns:
        The distance [m], positive outside, shape (n,), and the outward unit normal at
        the nearest place, shape (n, 3).
    """
    from scipy.spatial import KDTree

    corners = mesh.vertices[mesh.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=-1)
    # A triangle without area has its sides in common with others that have one.
    is_sound = area > 1e-12 * area.max()
    faces, corners = mesh.faces[is_sound], corners[is_sound]
    flat = cross[is_sound] / area[is_sound, None]
    normals = _feature_normals(mesh, faces, corners, flat)
    tree = KDTree(corners.mean(axis=1))
    distance, normal = np.empty(len(points)), np.empty((len(points), 3))
    for first in range(0, len(points), _CHUNK):
        part = slice(first, first + _CHUNK)
        _, near = tree.query(points[part], k=min(_CANDIDATES, len(faces)))
        near = near.reshape(len(points[part]), -1)
        distance[part], normal[part] = _nearest(points[part], near, corners, normals)
    return distance, normal


def _feature_normals(
    mesh: Mesh,
    faces: Int[np.ndarray, "face 3"],
    corners: Float[np.ndarray, "face 3 3"],
    flat: Float[np.ndarray, "face 3"],
) -> Float[np.ndarray, "face 7 3"]:
    """Return the normals of each triangle's three corners, three edges and itself.

    Edge k runs from corner k to the next one.
    """
    side = np.roll(corners, -1, axis=1) - corners
    side = side / np.linalg.norm(side, axis=-1, keepdims=True)
    cosine = -np.einsum("fki,fki->fk", side, np.roll(side, 1, axis=1))
    angle = np.arccos(np.clip(cosine, -1, 1))
    at_corner = np.zeros_like(mesh.vertices)
    np.add.at(at_corner, faces, angle[..., None] * flat[:, None])
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], -1), axis=-1)
    key = ends[..., 0].astype(np.int64) * len(mesh.vertices) + ends[..., 1]
    _, edge = np.unique(key.ravel(), return_inverse=True)
    edge = edge.reshape(key.shape)
    at_edge = np.zeros((int(edge.max()) + 1, 3))
    np.add.at(at_edge, edge, np.broadcast_to(flat[:, None], corners.shape))
    normals = np.concatenate([at_corner[faces], at_edge[edge], flat[:, None]], axis=1)
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    # Two triangles back to back have no outward side: any will do.
    return np.where(length > 1e-9, normals / np.maximum(length, 1e-9), flat[:, None])


def _nearest(
    points: Float[np.ndarray, "n 3"],
    near: Int[np.ndarray, "n k"],
    corners: Float[np.ndarray, "face 3 3"],
    normals: Float[np.ndarray, "face 7 3"],
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Return signed distance and normal of the nearest of some triangles each."""
    foot, feature = closest_on_triangles(points[:, None], corners[near])
    away = points[:, None] - foot
    best = np.argmin(np.sum(away**2, axis=-1), axis=1)
    row = np.arange(len(points))
    normal = normals[near[row, best], feature[row, best]]
    away = away[row, best]
    length = np.linalg.norm(away, axis=-1)
    is_inside = np.einsum("ni,ni->n", away, normal) < 0
    return np.where(is_inside, -length, length), normal


def closest_on_triangles(
    points: Float[np.ndarray, "n 1 3"], corners: Float[np.ndarray, "n k 3 3"]
) -> tuple[Float[np.ndarray, "n k 3"], Int[np.ndarray, "n k"]]:
    """Return the nearest point of each triangle, and where on it that is.

    Args:
        points: Points [m], shape (n, 1, 3).
        corners: Corners of k triangles for each point [m], shape (n, k, 3, 3).

    Returns:
        The nearest points [m], and 0 to 2 where it is a corner, 3 to 5 where it is on
        the edge from corner 0, 1, 2 to the next, 6 inside.
    """
    side = np.roll(corners, -1, axis=2) - corners
    normal = np.cross(side[:, :, 0], side[:, :, 1])
    area = np.einsum("nki,nki->nk", normal, normal)
    from_corner = points[:, :, None] - corners
    # Where along each side the foot is, 0 to 1.
    length = np.einsum("nkei,nkei->nke", side, side)
    t = np.clip(np.einsum("nkei,nkei->nke", from_corner, side) / length, 0, 1)
    feet = corners + t[..., None] * side
    away = np.sum((points[:, :, None] - feet) ** 2, axis=-1)
    edge = np.argmin(away, axis=-1)
    t = np.take_along_axis(t, edge[..., None], -1)[..., 0]
    feature = np.where(t <= 0, edge, np.where(t >= 1, (edge + 1) % 3, edge + 3))
    foot = np.take_along_axis(feet, edge[..., None, None], axis=2)[:, :, 0]
    # Inside if the point is to the left of every side.
    left = np.einsum("nkei,nki->nke", np.cross(side, from_corner), normal)
    is_inside = (left > 0).all(axis=-1)
    height = np.einsum("nki,nki->nk", from_corner[:, :, 0], normal) / area
    flat_foot = points - height[..., None] * normal
    foot = np.where(is_inside[..., None], flat_foot, foot)
    return foot, np.where(is_inside, 6, feature)
