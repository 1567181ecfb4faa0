"""A closed surface of triangles, and its faults."""

import math
from typing import ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from .signed_distance import SignedDistance

# A volume below this share of the box around a mesh is none.
_NO_VOLUME_SHARE = 1e-9
# A point so close to a triangle, in sizes of it, is on it.
_ON_TRIANGLE = 1e-6


class Mesh(eqx.Module):
    """A surface of triangles, on the host.

    Attributes:
        vertices: Corners in `work` [m], shape (vertex, 3).
        faces: Corners of each triangle, counter-clockwise from outside,
            shape (face, 3).
        FARTHEST: Largest coordinate of a part [m]; larger ones have another unit.
    """

    FARTHEST: ClassVar[float] = 100.0
    vertices: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]

    def volume(self) -> float:
        """Enclosed volume [m^3]; negative if the mesh is inside out."""
        return float(self._cone_volumes().sum())

    def extent_volume(self) -> float:
        """Volume of the box around the mesh [m^3]."""
        return float(np.prod(np.ptp(self.vertices, axis=0)))

    def open_edge_count(self) -> int:
        """Number of edges without a triangle on their other side."""
        surplus = self._edge_surplus()
        return int(np.abs(surplus).sum())

    def flipped_edge_count(self) -> int:
        """Number of edges along which two triangles run in the same direction."""
        return int((np.abs(self._edge_surplus()) == 2).sum())

    def inward_shell_count(self) -> int:
        """Number of closed shells that face inward, but are no cavities."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        start, stop = self.faces[:, :2].ravel(), self.faces[:, 1:].ravel()
        count = len(self.vertices)
        edges = coo_array((np.ones(len(start)), (start, stop)), (count, count))
        shell_count, shell_of = connected_components(edges, directed=False)
        shell_of = shell_of[self.faces[:, 0]]
        volume = np.bincount(shell_of, self._cone_volumes(), shell_count)
        inward = np.flatnonzero(volume < -_NO_VOLUME_SHARE * self.extent_volume())
        first = [np.argmax(shell_of == shell) for shell in inward]
        middles = self.vertices[self.faces[first]].mean(axis=1)
        bodies = Mesh(self.vertices, self.faces[volume[shell_of] > 0])
        # A half where a cavity touches the outside of a body.
        return sum(bodies._winding(point) < 0.25 for point in middles)

    def signed_distance(self) -> SignedDistance:
        """Distance of points to the mesh, closed and of like triangles."""
        return SignedDistance(self.vertices, self.faces)

    def _corners_from(
        self, point: Float[np.ndarray, " 3"]
    ) -> Float[np.ndarray, "3 face 3"]:
        return np.swapaxes((self.vertices - point)[self.faces], 0, 1)

    def _cone_volumes(self) -> Float[np.ndarray, " face"]:
        """Signed volume between each triangle and the middle [m^3]."""
        # About the middle: far from the origin the terms would cancel.
        a, b, c = self._corners_from(self.vertices.mean(axis=0))
        return np.einsum("ij,ij->i", a, np.cross(b, c)) / 6

    def _winding(self, point: Float[np.ndarray, " 3"]) -> float:
        """Winding number of the mesh about a point; on it the mean of both sides.

        A. van Oosterom and J. Strackee, The solid angle of a plane triangle, IEEE
        Transactions on Biomedical Engineering 30, 1983, equation 8.
        """
        a, b, c = self._corners_from(point)
        x, y, z = (np.linalg.norm(corner, axis=1) for corner in (a, b, c))
        triple, size = (a * np.cross(b, c)).sum(axis=1), x * y * z
        denominator = size + sum(
            (p * q).sum(axis=1) * r for p, q, r in ((a, b, z), (b, c, x), (c, a, y))
        )
        angle = np.arctan2(triple, denominator)
        half = np.where(np.abs(triple) > _ON_TRIANGLE * size, angle, 0)
        return float(half.sum()) / (2 * math.pi)

    def _edge_surplus(self) -> Int[np.ndarray, " edge"]:
        """Number of triangles along each edge minus those against it."""
        start = self.faces.ravel()
        stop = np.roll(self.faces, -1, axis=1).ravel()
        low, high = np.minimum(start, stop), np.maximum(start, stop)
        key = low.astype(np.int64) * len(self.vertices) + high
        _, edge = np.unique(key, return_inverse=True)
        count = np.zeros(edge.max(initial=-1) + 1, dtype=np.int64)
        np.add.at(count, edge, np.where(start < stop, 1, -1))
        return count


def weld(mesh: Mesh, tolerance: float = 0.0) -> Mesh:
    """Mesh whose equal vertices are one, without collapsed triangles.

    Args:
        mesh: Any mesh; formats such as STL repeat the corners of every triangle.
        tolerance: Distance within which vertices are equal [m].
    """
    # Adding zero makes -0 and 0 the same.
    vertices, index = np.unique(mesh.vertices + 0.0, axis=0, return_inverse=True)
    faces = index.reshape(-1)[mesh.faces]
    if tolerance > 0:
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components
        from scipy.spatial import KDTree

        count = len(vertices)
        near = KDTree(vertices).query_pairs(tolerance, output_type="ndarray")
        pairs = coo_array(
            (np.ones(len(near)), (near[:, 0], near[:, 1])), (count, count)
        )
        _, group = connected_components(pairs, directed=False)
        _, first = np.unique(group, return_index=True)
        vertices, faces = vertices[first], group[faces]
    is_flat = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    return Mesh(vertices, faces[~is_flat])


def vertex_fault(mesh: Mesh) -> str | None:
    """Fault of vertices that are no points of a part, as text; None without one."""
    if not np.isfinite(mesh.vertices).all():
        count = int((~np.isfinite(mesh.vertices)).any(axis=1).sum())
        return f"found {count} vertices that are not finite"
    farthest = float(np.abs(mesh.vertices).max(initial=0.0))
    if farthest > Mesh.FARTHEST:
        return (
            f"found a vertex {farthest:g} m from the origin; at most "
            f"{Mesh.FARTHEST:g} m are allowed"
        )
    return None


def mesh_fault(mesh: Mesh) -> str | None:
    """Fault of a welded mesh that bounds no solid, as text; None if there is none.

    Args:
        mesh: A mesh whose equal vertices are one.
    """
    if fault := vertex_fault(mesh):
        return fault
    if not len(mesh.faces):
        return "found no triangles"
    if flipped := mesh.flipped_edge_count():
        return (
            f"found {flipped} edges whose two triangles face opposite sides; all "
            "triangles must face outward"
        )
    if open_edges := mesh.open_edge_count():
        return f"found {open_edges} open edges; a closed surface is required"
    volume, extent = mesh.volume(), mesh.extent_volume()
    if abs(volume) <= _NO_VOLUME_SHARE * extent or extent == 0:
        return "found a surface that encloses no volume"
    if volume < 0:
        return (
            f"found a surface that is inside out (volume {volume:.3g} m^3); its "
            "triangles must face outward"
        )
    if inward := mesh.inward_shell_count():
        return (
            f"found {inward} of its bodies inside out; all triangles must face outward"
        )
    return None
