"""A closed surface of triangles, and what can be wrong with one."""

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from .signed_distance import SignedDistance


class Mesh(eqx.Module):
    """A surface of triangles, on the host.

    Attributes:
        vertices: Corners in `work` [m], shape (vertex, 3).
        faces: Corners of each triangle, counter-clockwise from outside,
            shape (face, 3).
    """

    vertices: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]

    def volume(self) -> float:
        """Return the enclosed volume [m^3]; negative if the mesh is inside out."""
        a, b, c = self._relative_corners()
        return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6

    def extent_volume(self) -> float:
        """Return the volume of the box around the mesh [m^3]."""
        return float(np.prod(np.ptp(self.vertices, axis=0)))

    def open_edge_count(self) -> int:
        """Return how many edges lack a triangle on their other side."""
        surplus = self._edge_surplus()
        return int(np.abs(surplus).sum())

    def flipped_edge_count(self) -> int:
        """Return how many edges two triangles run along in the same direction."""
        return int((np.abs(self._edge_surplus()) == 2).sum())

    def signed_distance(self) -> SignedDistance:
        """Return the distance of points to the mesh, closed and of like triangles."""
        return SignedDistance(self.vertices, self.faces)

    def _relative_corners(self) -> Float[np.ndarray, "3 face 3"]:
        # About the middle: far from the origin the terms would cancel.
        middle = self.vertices.mean(axis=0)
        return np.swapaxes((self.vertices - middle)[self.faces], 0, 1)

    def _edge_surplus(self) -> Int[np.ndarray, " edge"]:
        """Return for each edge the triangles along it minus those against it."""
        start = self.faces.ravel()
        stop = np.roll(self.faces, -1, axis=1).ravel()
        low, high = np.minimum(start, stop), np.maximum(start, stop)
        key = low.astype(np.int64) * len(self.vertices) + high
        _, edge = np.unique(key, return_inverse=True)
        count = np.zeros(edge.max(initial=-1) + 1, dtype=np.int64)
        np.add.at(count, edge, np.where(start < stop, 1, -1))
        return count


def weld(mesh: Mesh) -> Mesh:
    """Return a mesh whose equal vertices are one, without collapsed triangles.

    Args:
        mesh: Any mesh; formats such as STL repeat the corners of every triangle.
    """
    # Adding zero makes -0 and 0 the same.
    vertices, index = np.unique(mesh.vertices + 0.0, axis=0, return_inverse=True)
    faces = index.reshape(-1)[mesh.faces]
    is_flat = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    return Mesh(vertices, faces[~is_flat])


def mesh_fault(mesh: Mesh) -> str | None:
    """Return what keeps a welded mesh from bounding a solid, or None.

    Args:
        mesh: A mesh whose equal vertices are one.
    """
    if not np.isfinite(mesh.vertices).all():
        count = int((~np.isfinite(mesh.vertices)).any(axis=1).sum())
        return f"found {count} vertices that are not finite"
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
    if abs(volume) <= 1e-9 * extent or extent == 0:
        return "found a surface that encloses no volume"
    if volume < 0:
        return (
            f"found a surface that is inside out (volume {volume:.3g} m^3); its "
            "triangles must face outward"
        )
    return None
