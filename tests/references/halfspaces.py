"""Raw stock as unions of convex pieces, each an intersection of half-spaces.

The constructors place the tool's tip at the origin, its axis along +z and the feed
along +x; `rotated` and `shifted` bring the stock elsewhere. What earlier passes have
removed is no part of it: the integrator subtracts that itself.
"""

import dataclasses
import math

import numpy as np


@dataclasses.dataclass(frozen=True)
class Piece:
    """A convex piece: the points x with normals @ x <= offsets.

    Attributes:
        normals: Outward normals, unit length, shape (plane, 3).
        offsets: Distances of the planes from the origin [m], shape (plane,).
    """

    normals: np.ndarray
    offsets: np.ndarray


@dataclasses.dataclass(frozen=True)
class Stock:
    """A union of convex pieces, which may overlap.

    Attributes:
        pieces: The pieces.
    """

    pieces: tuple[Piece, ...]

    def rotated(self, rotation: np.ndarray) -> "Stock":
        """Return the stock turned about the origin; rotation has shape (3, 3)."""
        return Stock(
            tuple(Piece(p.normals @ rotation.T, p.offsets) for p in self.pieces)
        )

    def shifted(self, shift: np.ndarray) -> "Stock":
        """Return the stock moved by `shift` [m], shape (3,)."""
        return Stock(
            tuple(Piece(p.normals, p.offsets + p.normals @ shift) for p in self.pieces)
        )

    def __or__(self, other: "Stock") -> "Stock":
        return Stock(self.pieces + other.pieces)

    def __and__(self, other: "Stock") -> "Stock":
        return Stock(
            tuple(
                Piece(
                    np.concatenate([a.normals, b.normals]),
                    np.concatenate([a.offsets, b.offsets]),
                )
                for a in self.pieces
                for b in other.pieces
            )
        )

    def fraction(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Return the share of straight segments that lies in the stock.

        Args:
            start: First ends [m], shape (..., 3).
            end: Second ends [m], shape (..., 3).

        Returns:
            Shares between 0 and 1, shape (...).
        """
        spans = [_span(piece, start, end) for piece in self.pieces]
        low = np.stack([span[0] for span in spans])
        high = np.stack([span[1] for span in spans])
        # Measure of a union of intervals: in order of their starts, each adds what
        # lies beyond all before it.
        order = np.argsort(low, axis=0)
        low = np.take_along_axis(low, order, axis=0)
        high = np.take_along_axis(high, order, axis=0)
        total, reached = np.zeros(low.shape[1:]), np.zeros(low.shape[1:])
        for a, b in zip(low, high, strict=True):
            total += np.maximum(b - np.maximum(a, reached), 0)
            reached = np.maximum(reached, b)
        return total


def _span(
    piece: Piece, start: np.ndarray, end: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the parameters in [0, 1] between which each segment is in the piece."""
    low, high = np.zeros(start.shape[:-1]), np.ones(start.shape[:-1])
    for normal, offset in zip(piece.normals, piece.offsets, strict=True):
        inside_start, inside_end = offset - start @ normal, offset - end @ normal
        slope = inside_end - inside_start
        crossing = -inside_start / np.where(slope == 0, 1, slope)
        low = np.where(slope > 0, np.maximum(low, crossing), low)
        high = np.where(slope < 0, np.minimum(high, crossing), high)
        high = np.where((slope == 0) & (inside_start < 0), 0, high)
    return low, np.maximum(high, low)


def half_space(normal: np.ndarray, offset: float) -> Stock:
    """Return the stock normal @ x <= offset; the normal need not have unit length.

    Args:
        normal: Outward normal, shape (3,).
        offset: Distance of the plane from the origin along the unit normal [m].
    """
    unit = np.asarray(normal, float) / np.linalg.norm(normal)
    return Stock((Piece(unit[None, :], np.array([float(offset)])),))


def slot(axial_depth: float) -> Stock:
    """Return a block that the tool crosses at full width.

    Args:
        axial_depth: Height of the block's top above the tip a_p [m].
    """
    return half_space(np.array([0.0, 0.0, 1.0]), axial_depth)


def shoulder(
    axial_depth: float, radial_depth: float, radius: float, *, is_up_milling: bool
) -> Stock:
    """Return a block of which the tool cuts a side.

    In up-milling the teeth enter at angle 0, where the tool's rim touches y = radius;
    so the block lies at +y, and in down-milling at -y.

    Args:
        axial_depth: Height of the block's top above the tip a_p [m].
        radial_depth: Width of the cut a_e [m].
        radius: Radius of the tool [m].
        is_up_milling: Whether the teeth enter with thin chips.
    """
    side = np.array([0.0, -1.0 if is_up_milling else 1.0, 0.0])
    return slot(axial_depth) & half_space(side, radial_depth - radius)


def inclined_plane(slope: float, direction: float, axial_depth: float) -> Stock:
    """Return the stock below an inclined plane, as cut by a vertical tool.

    Args:
        slope: Angle between the plane and the horizontal [rad].
        direction: Angle from +x toward +y of the way uphill [rad].
        axial_depth: Height of the plane above the tip, along the axis [m].
    """
    normal = np.array(
        [
            -math.sin(slope) * math.cos(direction),
            -math.sin(slope) * math.sin(direction),
            math.cos(slope),
        ]
    )
    return half_space(normal, axial_depth * math.cos(slope))
