"""Pieces of rays as lists, apart and together again."""

import jax
import numpy as np

import diffmill.workpiece as wp
from diffmill.workpiece import StockPieces

# A bar along x with slots across it: gaps from 1 to 2 mm, and from 5 to 6 mm.
GAPS = ((1e-3, 2e-3), (5e-3, 6e-3))


def bar():
    """Return a bar of 8 x 2 x 1 mm, whose rays along x have three pieces."""
    stock = wp.box([0, 0, 0], [8e-3, 2e-3, 1e-3], 0.5e-3, interval_counts=(5, 2, 1))
    x, y, z = (np.array(rays.ends) for rays in stock.families)
    is_live = x[:, :, 1, 0] > x[:, :, 0, 0]
    lows, highs = zip((0, 1e-3), (6e-3, 8e-3), (2e-3, 5e-3), strict=True)
    # In no order, with an empty slot in between.
    for slot, low, high in zip((0, 3, 4), lows, highs, strict=True):
        x[is_live, 0, slot], x[is_live, 1, slot] = low, high
    lines = np.asarray(stock.origin)[0] + stock.spacing * np.arange(y.shape[1])
    for low, high in GAPS:
        is_gap = (lines > low) & (lines < high)
        y[:, is_gap, 0], y[:, is_gap, 1] = wp.Rays.DEAD, -wp.Rays.DEAD
        z[is_gap, :, 0], z[is_gap, :, 1] = wp.Rays.DEAD, -wp.Rays.DEAD
    poses = [rays.poses for rays in stock.families]
    families = tuple(map(wp.Rays, map(jax.numpy.asarray, (x, y, z)), poses))
    return jax.tree.unflatten(
        jax.tree.structure(stock),
        [
            *jax.tree.leaves(families),
            stock.origin,
        ],
    )


def test_pieces_are_those_of_the_rays():
    stock = bar()
    pieces = StockPieces.of(stock)
    assert pieces.most_on_a_ray() == (3, 1, 1)
    along_x = pieces.families[0]
    assert along_x.ray.size == 3 * 4 * 2
    np.testing.assert_allclose(
        along_x.ends[:3], [[0, 1e-3], [6e-3, 8e-3], [2e-3, 5e-3]]
    )
    again = pieces.stock(stock, (3, 1, 1))
    assert again.interval_counts == (3, 1, 1)
    np.testing.assert_allclose(again.volumes(), stock.volumes(), rtol=1e-12)
    equal = jax.tree.map(np.array_equal, StockPieces.of(again), pieces)
    assert all(jax.tree.leaves(equal))


def test_pieces_that_reach_into_a_box_are_near_and_whole():
    stock = bar()
    box = np.array([1.5e-3, -1e-3, -1e-3]), np.array([3e-3, 0.6e-3, 2e-3])
    near, far = StockPieces.of(stock).parted(stock, *box)
    along_x, along_y, along_z = near.families
    # The middle piece of the rays at y = 0.25 mm, of two heights.
    np.testing.assert_allclose(along_x.ends, [[2e-3, 5e-3]] * 2)
    # Rays at x = 2.25 and 2.75 mm: along y at two heights, along z at one place.
    np.testing.assert_allclose(along_y.ends, [[0, 2e-3]] * 4)
    np.testing.assert_allclose(along_z.ends, [[0, 1e-3]] * 2)
    both = near.joined(far).stock(stock, (3, 1, 1))
    np.testing.assert_allclose(both.volumes(), stock.volumes(), rtol=1e-12)
    nothing = StockPieces.none(stock)
    assert nothing.most_on_a_ray() == (0, 0, 0)
    equal = jax.tree.map(np.array_equal, far.joined(nothing), far)
    assert all(jax.tree.leaves(equal))
