import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from diffmill.viz import CutDexels
from diffmill.workpiece import box


def pocket(depth, half_width):
    """A block with a square pocket in its middle, its rays edited by hand."""
    stock = box([-4e-3, -4e-3, -3e-3], [4e-3, 4e-3, 0.0], 0.5e-3)
    origin, spacing = np.asarray(stock.origin), stock.spacing
    lines = [origin[a] + spacing * np.arange(64) for a in range(3)]

    def inside(axis, count):
        return np.abs(lines[axis][:count]) < half_width

    ends, poses = (
        np.array(v) for v in (stock.families[2].ends, stock.families[2].poses)
    )
    cut = inside(0, ends.shape[0])[:, None] & inside(1, ends.shape[1])[None]
    ends[cut, 1, 0], poses[cut, 1, 0] = -depth, 3
    ends_x, poses_x = (
        np.array(v) for v in (stock.families[0].ends, stock.families[0].poses)
    )
    heights = lines[2][: ends_x.shape[1]]
    cut = inside(1, ends_x.shape[0])[:, None] & (heights > -depth)[None]
    cut &= heights[None] < 0.0
    ends_x[cut, 1, 1], ends_x[cut, 0, 1] = ends_x[cut, 1, 0], half_width
    ends_x[cut, 1, 0] = -half_width
    poses_x[cut, 1, 0] = poses_x[cut, 0, 1] = 3
    return eqx.tree_at(
        lambda s: (
            s.families[2].ends,
            s.families[2].poses,
            s.families[0].ends,
            s.families[0].poses,
        ),
        stock,
        tuple(jnp.asarray(v) for v in (ends, poses, ends_x, poses_x)),
    )


def test_cut_ends_hold_floor_and_both_walls():
    stock, ideal = pocket(0.9e-3, 2.05e-3), pocket(1.0e-3, 2.0e-3)
    dexels = CutDexels.from_stocks(stock, ideal)
    np.testing.assert_allclose(dexels.floor[:, 2], -0.9e-3)
    np.testing.assert_allclose(dexels.floor_error(), 1e-4)
    np.testing.assert_allclose(np.abs(dexels.wall[:, 0]), 2.05e-3)
    error = dexels.wall_error()
    known = np.isfinite(error)
    assert known.any()
    np.testing.assert_allclose(
        error[known], 0.05e-3 * np.sign(dexels.wall[known, 0]), rtol=1e-6
    )


def test_uncut_stock_has_neither_floor_nor_wall():
    raw = box([0.0, 0.0, 0.0], [4e-3, 4e-3, 2e-3], 0.5e-3)
    dexels = CutDexels.from_stocks(raw, raw)
    assert dexels.floor.shape == (0, 3) and dexels.wall.shape == (0, 3)


def test_another_grid_is_refused():
    one = box([0.0, 0.0, 0.0], [4e-3, 4e-3, 2e-3], 0.5e-3)
    other = box([0.0, 0.0, 0.0], [4e-3, 4e-3, 2e-3], 0.4e-3)
    with pytest.raises(ValueError, match="`ideal`"):
        CutDexels.from_stocks(one, other)
