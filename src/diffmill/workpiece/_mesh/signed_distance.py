"""Signed distance of points to a closed mesh of small, like triangles.

The sign comes from the sum of the normals of the triangles at the nearest place,
weighted by their angles, which is right at edges and corners too.

Reference: Baerentzen, Aanaes, Signed distance computation using the angle weighted
pseudonormal, 2005, for the sign.
"""

import numpy as np
from jaxtyping import Float, Int

# Triangles of the mesh are about one spacing large: the nearest is among these.
_CANDIDATES = 24
# Points at a time: bounds the memory.
_CHUNK = 5_000


class SignedDistance:
    """Distance of points to a closed mesh of small, like triangles.

    Args:
        vertices: Corners of the mesh [m], shape (vertex, 3).
        faces: Corners of each triangle, counter-clockwise from outside.
    """

    def __init__(
        self,
        vertices: Float[np.ndarray, "vertex 3"],
        faces: Int[np.ndarray, "face 3"],
    ):
        from scipy.spatial import KDTree

        corners = vertices[faces]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.linalg.norm(cross, axis=-1)
        # A triangle without area has its sides in common with others that have one.
        is_sound = area > 1e-12 * area.max()
        faces, self._corners = faces[is_sound], corners[is_sound]
        flat = cross[is_sound] / area[is_sound, None]
        self._normals = _FeatureNormals(vertices, faces, self._corners, flat)
        middles = self._corners.mean(axis=1)
        away = np.linalg.norm(self._corners - middles[:, None], axis=-1)
        self._radii = away.max(axis=1)
        self._tree = KDTree(middles)

    def __call__(
        self, points: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
        """Distances of points, and outward unit normals at the nearest places.

        Args:
            points: Points [m], shape (n, 3).

        Returns:
            Distances [m], positive outside, shape (n,), and normals, shape (n, 3).
        """
        distance, normal = np.empty(len(points)), np.empty((len(points), 3))
        for first in range(0, len(points), _CHUNK):
            part = slice(first, first + _CHUNK)
            distance[part], normal[part] = self._nearest(points[part])
        return distance, normal

    def _nearest(
        self, points: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
        """Distances from the nearest triangles [m], and normals there."""
        count = min(_CANDIDATES, len(self._corners))
        apart, near = self._tree.query(points, k=count)
        apart, near = (x.reshape(len(points), -1) for x in (apart, near))
        # None is nearer than its middle less its radius, and one as near as its middle.
        may_be = apart - self._radii[near] <= apart[:, :1]
        row, triangle = np.nonzero(may_be)[0], near[may_be]
        feet, feature = closest_on_triangles(points[row], self._corners[triangle])
        away = points[row] - feet
        square = np.einsum("ni,ni->n", away, away)
        least = np.minimum.reduceat(square, np.flatnonzero(np.diff(row, prepend=-1)))
        is_best = np.flatnonzero(square == least[row])
        best = is_best[np.diff(row[is_best], prepend=-1) > 0]
        away, normal = away[best], self._normals(triangle[best], feature[best])
        is_inside = np.einsum("ni,ni->n", away, normal) < 0
        length = np.sqrt(least)
        return np.where(is_inside, -length, length), normal


class _FeatureNormals:
    """Outward unit normals of triangles: of their corners, their edges and themselves.

    Edge k of a triangle runs from corner k to the next one.
    """

    def __init__(
        self,
        vertices: Float[np.ndarray, "vertex 3"],
        faces: Int[np.ndarray, "face 3"],
        corners: Float[np.ndarray, "face 3 3"],
        flat: Float[np.ndarray, "face 3"],
    ):
        side = np.roll(corners, -1, axis=1) - corners
        side /= np.linalg.norm(side, axis=-1, keepdims=True)
        cosine = -np.einsum("fki,fki->fk", side, np.roll(side, 1, axis=1))
        del side
        angle = np.arccos(np.clip(cosine, -1, 1))
        self._at_corner = np.zeros_like(vertices)
        for k in range(3):
            np.add.at(self._at_corner, faces[:, k], angle[:, k, None] * flat)
        ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], -1), axis=-1)
        key = ends[..., 0].astype(np.int64) * len(vertices) + ends[..., 1]
        _, edge = np.unique(key.ravel(), return_inverse=True)
        self._edges, self._faces = edge.reshape(key.shape), faces
        self._at_edge, self._flat = np.zeros((int(edge.max()) + 1, 3)), flat
        for k in range(3):
            np.add.at(self._at_edge, self._edges[:, k], flat)

    def __call__(
        self, triangle: Int[np.ndarray, " n"], feature: Int[np.ndarray, " n"]
    ) -> Float[np.ndarray, "n 3"]:
        """Normals of features of triangles, as `closest_on_triangles` numbers them."""
        flat, k, kind = self._flat[triangle], feature % 3, (feature // 3)[:, None]
        corner = self._at_corner[self._faces[triangle, k]]
        edge = self._at_edge[self._edges[triangle, k]]
        normal = np.where(kind == 0, corner, np.where(kind == 1, edge, flat))
        length = np.linalg.norm(normal, axis=-1, keepdims=True)
        # Two triangles back to back have no outward side: any will do.
        return np.where(length > 1e-9, normal / np.maximum(length, 1e-9), flat)


def closest_on_triangles(
    points: Float[np.ndarray, "n 3"], corners: Float[np.ndarray, "n 3 3"]
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"]]:
    """Nearest point of a triangle to each point, and the feature on which it lies.

    Args:
        points: Points [m], shape (n, 3).
        corners: Corners of the triangles [m], shape (n, 3, 3).

    Returns:
        Nearest points [m], shape (n, 3), and features: 0 to 2 for a corner, 3 to 5 for
        the edge from corner 0, 1, 2 to the next, 6 inside, shape (n,).
    """
    row = np.arange(len(points))
    side = np.roll(corners, -1, axis=1) - corners
    normal = np.cross(side[:, 0], side[:, 1])
    area = np.einsum("ni,ni->n", normal, normal)
    from_corner = points[:, None] - corners
    # Place of the foot along each side, 0 to 1.
    length = np.einsum("nei,nei->ne", side, side)
    t = np.clip(np.einsum("nei,nei->ne", from_corner, side) / length, 0, 1)
    feet = corners + t[..., None] * side
    away = np.sum((points[:, None] - feet) ** 2, axis=-1)
    edge = np.argmin(away, axis=-1)
    t = t[row, edge]
    feature = np.where(t <= 0, edge, np.where(t >= 1, (edge + 1) % 3, edge + 3))
    foot = feet[row, edge]
    # Inside if the point is to the left of every side.
    left = np.einsum("nei,ni->ne", np.cross(side, from_corner), normal)
    is_inside = (left > 0).all(axis=-1)
    height = np.einsum("ni,ni->n", from_corner[:, 0], normal) / area
    flat_foot = points - height[..., None] * normal
    foot = np.where(is_inside[:, None], flat_foot, foot)
    return foot, np.where(is_inside, 6, feature)
