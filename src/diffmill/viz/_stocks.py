"""Cut ray ends of finished workpieces, for the figures.

The ideal workpiece is what the same process leaves on the desired path, on the same
grid of rays.
"""

import numpy as np
from jaxtyping import Float

from ..workpiece import Stock
from ._figure.dexels import CutDexels


def cut_dexels(stock: Stock, ideal: Stock) -> CutDexels:
    """Return the ends that the tool has cut: floors of z rays, walls of x rays.

    Args:
        stock: The workpiece after the cut.
        ideal: The workpiece after the same cut on the desired path.

    Returns:
        Upper ends of z rays and both ends of x rays, where a pose made them.
    """
    _require_same_grid(stock, ideal)
    return CutDexels(
        _cut_ends(stock, 2, is_upper_only=True),
        _cut_ends(ideal, 2, is_upper_only=True),
        _cut_ends(stock, 0),
        _cut_ends(ideal, 0),
    )


def _cut_ends(
    stock: Stock, family: int, *, is_upper_only: bool = False
) -> Float[np.ndarray, "end 3"]:
    """Return the ends of one family that remember a tool pose."""
    points, side = stock.ray_ends(family)
    rays = stock.families[family]
    ends = np.asarray(rays.ends)
    is_live = np.broadcast_to((ends[:, :, 1] > ends[:, :, 0])[:, :, None], ends.shape)
    is_cut = np.asarray(rays.poses)[is_live] >= 0
    if is_upper_only:
        is_cut &= side > 0
    return np.asarray(points[is_cut], dtype=np.float64)


def _require_same_grid(stock: Stock, ideal: Stock) -> None:
    if stock.grid_shape != ideal.grid_shape or not np.allclose(
        np.asarray(stock.origin), np.asarray(ideal.origin), rtol=0.0, atol=1e-9
    ):
        raise ValueError(
            "Argument `ideal` must have the grid of rays of `stock`, "
            f"{stock.grid_shape}, but has {ideal.grid_shape} or another origin."
        )
