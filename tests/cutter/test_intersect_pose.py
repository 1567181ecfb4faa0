import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

from .mills import (
    CORNERS,
    TIP,
    R,
    arrays,
    mill,
    numpy_level,
    random_axes,
    ray_points,
    unit,
)

SPAN = 0.05
AXES = {
    "up": [0, 0, 1.0],
    "along_x": [1.0, 0, 0],
    "against_y": [0, -1.0, 0],
    "down": [0, 0, -1.0],
    "nearly_up": unit([1e-7, -2e-7, 1]),
    "nearly_across": unit([1, 1e-9, 1e-13]),
    "tilted": unit([0.2, -0.1, 1]),
    **{f"random_{i}": axis for i, axis in enumerate(random_axes(4))},
}


def rays(count, seed):
    rng = np.random.default_rng(seed)
    return rng.uniform(-9e-3, 9e-3, (2, count))


def bracketed(family, b, c, axis, corner):
    """Return entry and exit within +-SPAN by root bracketing, or None."""

    def level(t):
        return numpy_level(ray_points(family, b, c, t), TIP, axis, corner)

    t = np.linspace(-SPAN, SPAN, 5001)
    inside = np.flatnonzero(level(t) < 0)
    if not len(inside):
        return None
    middle = t[inside[len(inside) // 2]]
    ends = []
    for end in (-SPAN, SPAN):
        is_open = level(np.array(end)) < 0
        root = None if is_open else brentq(level, middle, end, xtol=1e-15)
        ends.append(root)
    return ends


@pytest.mark.parametrize("family", [0, 1, 2])
@pytest.mark.parametrize("name", CORNERS)
def test_ends_are_where_root_bracketing_finds_them(name, family):
    tool, count = mill(name), 0
    intersect = jax.jit(lambda b, c, a: tool.intersect_pose(family, b, c, TIP_, a))
    for i, axis in enumerate(AXES.values()):
        axis = np.asarray(axis)
        b, c = rays(40, i)
        b, c = b + TIP[(family + 1) % 3], c + TIP[(family + 2) % 3]
        start, stop, is_hit = intersect(*arrays(b, c, axis))
        assert np.isfinite(start).all() and np.isfinite(stop).all()
        for k in range(40):
            ends = bracketed(family, b[k], c[k], axis, CORNERS[name])
            low, high = ends or (0.0, 0.0)
            chord = (SPAN if high is None else high) - (-SPAN if low is None else low)
            if 0 < chord < 0.0402 * R:
                assert chord > 0.0398 * R or not is_hit[k]
                continue
            assert bool(is_hit[k]) == (ends is not None)
            if ends is None:
                continue
            count += 1
            for found, wanted, outer in (
                (start[k], low, -SPAN),
                (stop[k], high, SPAN),
            ):
                if wanted is None:
                    assert abs(found) >= SPAN and found * outer > 0
                else:
                    at = numpy_level(
                        ray_points(family, b[k], c[k], np.asarray(found)),
                        TIP,
                        axis,
                        CORNERS[name],
                    )
                    assert abs(at) < 1e-15
                    np.testing.assert_allclose(found, wanted, atol=1e-11)
    assert count > 50


TIP_ = jnp.asarray(TIP)


@pytest.mark.parametrize("family", [0, 1, 2])
@pytest.mark.parametrize("name", ["flat", "ball", "bull"])
def test_an_upright_pose_agrees_with_the_fast_path(name, family):
    tool = mill(name)
    b, c = arrays(*rays(2000, 11))
    z = jnp.array([0.0, 0.0, 1.0])
    fast = tool.intersect(family, b, c, TIP_)
    posed = tool.intersect_pose(family, b, c, TIP_, z)
    np.testing.assert_array_equal(fast[2], posed[2])
    hit = fast[2]
    assert 200 < hit.sum() < 1800
    np.testing.assert_allclose(fast[0][hit], posed[0][hit], atol=1e-15)
    np.testing.assert_allclose(fast[1][hit], posed[1][hit], atol=1e-15)

    def total(intersect):
        def of(tip, tool):
            low, high, hit = intersect(tool, tip)
            chosen = hit & (high - low > 1e-3)
            return jnp.sum(jnp.where(chosen, low + 0.3 * high, 0))

        return jax.grad(of, argnums=(0, 1))(TIP_, floats(tool))

    by_fast = total(lambda tool, tip: tool.intersect(family, b, c, tip))
    by_pose = total(lambda tool, tip: tool.intersect_pose(family, b, c, tip, z))
    for x, y in zip(jax.tree.leaves(by_fast), jax.tree.leaves(by_pose), strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-9, atol=1e-9)


def floats(tool):
    return jax.tree.map(jnp.asarray, tool)


@pytest.mark.parametrize("family", [0, 1, 2])
@pytest.mark.parametrize("name", ["flat", "ball", "bull"])
def test_ends_move_as_finite_differences_say(name, family):
    b, c = arrays(*rays(60, 12))

    def ends(x):
        axis = x[3:6] / jnp.linalg.norm(x[3:6])
        tool = mill(name, x[6], x[7])
        start, stop, hit = tool.intersect_pose(family, b, c, x[:3], axis)
        return jnp.stack([start, stop]), hit & (stop - start > 2e-3)

    values, forward, backward = (
        jax.jit(f)
        for f in (
            jax.vmap(ends),
            jax.jacfwd(lambda x: ends(x)[0]),
            jax.jacrev(lambda x: ends(x)[0]),
        )
    )
    steps = np.diag([1e-9] * 3 + [1e-7] * 3 + [1e-9] * 2)
    smooth_count = 0
    for axis in (AXES[k] for k in ("along_x", "against_y", "up", "tilted", "random_0")):
        x = jnp.asarray([*TIP, *axis, 2 * R, CORNERS[name]])
        slopes = np.asarray(forward(x))
        assert np.isfinite(slopes).all()
        np.testing.assert_allclose(backward(x), slopes, rtol=1e-9, atol=1e-12)
        value, hit = values(x[None])
        high, low = (np.asarray(values(x[None] + h)[0]) for h in (steps, -steps))
        wanted = np.moveaxis((high - low) / (2 * np.diag(steps)[:, None, None]), 0, -1)
        bend = np.moveaxis(np.abs(high + low - 2 * value), 0, -1)
        # One-sided slopes differ where a ray meets an edge; cut-off ends stand still.
        is_near = np.abs(value[0]) < 0.1
        is_smooth = is_near & hit & np.all(bend < 1e-3 * np.diag(steps), axis=-1)
        error = np.abs(slopes - wanted) / (1 + np.abs(wanted))
        assert (error[is_smooth] < 1e-5).all()
        assert (slopes[~is_near & hit] == 0).all()
        smooth_count += is_smooth.sum()
    assert smooth_count > 100


def test_a_ray_through_the_flat_end_moves_with_it_alone():
    def start(tip, diameter):
        b, c = arrays(np.array([TIP[0]]), np.array([TIP[1]]))
        z = jnp.array([0.0, 0.0, 1.0])
        low, high, _ = mill("flat", diameter).intersect_pose(2, b, c, tip, z)
        return low[0] + 0 * high[0]

    by_tip, by_diameter = jax.grad(start, argnums=(0, 1))(TIP_, jnp.asarray(2 * R))
    np.testing.assert_array_equal(by_tip, [0, 0, 1])
    assert by_diameter == 0


def test_rays_that_only_touch_are_left_whole():
    z = jnp.array([0.0, 0.0, 1.0])
    offsets = R * np.sqrt(1 - np.array([0.019, 0.021]) ** 2)
    b, c = arrays(TIP[1] + offsets, np.full(2, TIP[2] + 1e-3))
    _, _, hit = mill("flat").intersect_pose(0, b, c, TIP_, z)
    assert hit.tolist() == [False, True]
    b, c = arrays(np.full(2, TIP[1]), TIP[2] + np.array([0.5e-9, 2e-9]))
    _, _, hit = mill("flat").intersect_pose(0, b, c, TIP_, z)
    assert hit.tolist() == [False, True]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["flat", "ball", "bull"])
def test_single_precision_stays_single_and_close(name):
    b, c = rays(300, 13)
    axis = np.asarray(AXES["tilted"])
    double = mill(name).intersect_pose(0, *arrays(b, c, TIP, axis))
    tool = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), mill(name))
    single = tool.intersect_pose(
        0, *(jnp.asarray(x, jnp.float32) for x in (b, c, TIP, axis))
    )
    both = double[2] & single[2] & (double[1] - double[0] > 1e-3)
    assert single[0].dtype == jnp.float32 and both.sum() > 50
    for i in (0, 1):
        np.testing.assert_allclose(single[i][both], double[i][both], atol=2e-7)


@pytest.mark.slow
def test_poses_and_rays_broadcast():
    b, c = arrays(*rays(6, 14))
    axes = jnp.asarray(random_axes(5))
    tool = mill("bull")
    all_at_once = tool.intersect_pose(0, b, c, TIP_, axes[:, None])
    one_by_one = jax.vmap(lambda a: tool.intersect_pose(0, b, c, TIP_, a))(axes)
    for x, y in zip(all_at_once, one_by_one, strict=True):
        np.testing.assert_allclose(x, y, atol=1e-15)
