import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from .mills import CORNERS, TIP, R, arrays, mill, numpy_level, random_axes, unit


def profile(corner, count=40_001):
    """Return points on the outline in the half plane (distance, height)."""
    kappa = np.linspace(0, np.pi / 2, count)
    arc = [R - corner + corner * np.sin(kappa), corner * (1 - np.cos(kappa))]
    bottom = [np.linspace(0, R - corner, count), np.zeros(count)]
    side = [np.full(count, R), np.linspace(corner, 30e-3, count)]
    return np.concatenate([bottom, arc, side], axis=1).T


def is_inside(rho, u, corner):
    drop = np.sqrt(np.maximum(corner**2 - np.maximum(corner - u, 0) ** 2, 0))
    return (u > 0) & (rho < R - corner + np.where(u < corner, drop, corner))


@pytest.mark.parametrize("name", CORNERS)
def test_level_is_the_distance_to_the_nearest_point_of_the_outline(name):
    rng = np.random.default_rng(3)
    corner, outline = CORNERS[name], profile(CORNERS[name])
    rho, u = rng.uniform(0, 9e-3, 200), rng.uniform(-5e-3, 12e-3, 200)
    axes = random_axes(200)
    across = unit(np.cross(axes, random_axes(200, 1)))
    points = TIP + u[:, None] * axes + rho[:, None] * across
    nearest = np.array(
        [np.hypot(*(outline - [r, h]).T).min() for r, h in zip(rho, u, strict=True)]
    )
    wanted = np.where(is_inside(rho, u, corner), -nearest, nearest)
    found = mill(name).level(*arrays(points, TIP, axes))
    # Points of the outline are at most 0.6 um apart.
    np.testing.assert_allclose(found, wanted, atol=0.3e-6)
    clear = nearest > 0.2e-3
    np.testing.assert_allclose(found[clear], wanted[clear], atol=1e-9)


@pytest.mark.parametrize("name", CORNERS)
def test_normal_is_the_gradient_of_the_level(name):
    rng = np.random.default_rng(4)
    axis = random_axes(1, 7)[0]
    points = TIP + rng.uniform(-8e-3, 8e-3, (400, 3))
    normals = np.asarray(mill(name).normal(*arrays(points, TIP, axis)))
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, rtol=1e-12)
    h = 1e-8
    steps = h * np.eye(3)

    def level(x):
        return numpy_level(x, TIP, axis, CORNERS[name])

    slopes = np.stack(
        [(level(points + s) - level(points - s)) / (2 * h) for s in steps]
    )
    # A difference across an edge of the distance itself says nothing.
    bend = np.stack(
        [level(points + s) + level(points - s) - 2 * level(points) for s in steps]
    )
    is_smooth = np.abs(bend).max(axis=0) < 1e-13
    assert is_smooth.mean() > 0.95
    np.testing.assert_allclose(normals[is_smooth], slopes.T[is_smooth], atol=2e-5)


@pytest.mark.parametrize("name", CORNERS)
@pytest.mark.parametrize("axis", [[0, 0, 1.0], [1.0, 0, 0], [0.6, 0, 0.8]])
@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32])
def test_normals_and_gradients_are_finite_at_the_awkward_points(name, axis, dtype):
    axis = np.array(axis)
    e = unit(np.cross(axis, [0.3, 0.5, -0.2]))
    places = [(0, 0), (0, -1e-3), (0, CORNERS[name]), (0, 7e-3), (R, 0), (R, 7e-3)]
    places += [(R - CORNERS[name], 0), (R - CORNERS[name], CORNERS[name])]
    points = np.stack([TIP + u * axis + r * e for r, u in places])
    tip, axis, points = (jnp.asarray(x, dtype) for x in (TIP, axis, points))
    tool = mill(name)
    normals = tool.normal(points, tip, axis)
    assert normals.dtype == dtype
    np.testing.assert_allclose(jnp.linalg.norm(normals, axis=-1), 1, rtol=1e-5)

    def total(tool, points, tip, axis):
        level = tool.level(points, tip, axis)
        assert level.dtype == dtype
        return jnp.sum(level) + jnp.sum(tool.normal(points, tip, axis))

    gradients = jax.grad(total, argnums=(0, 1, 2, 3))(
        jax.tree.map(lambda x: jnp.asarray(x, dtype), tool), points, tip, axis
    )
    assert all(np.isfinite(g).all() for g in jax.tree.leaves(gradients))


@pytest.mark.parametrize("name", ["flat", "ball", "bull"])
def test_level_moves_with_pose_and_sizes_as_finite_differences_say(name):
    rng = np.random.default_rng(5)
    points = jnp.asarray(TIP + rng.uniform(-8e-3, 8e-3, (50, 3)))
    corner = CORNERS[name]

    def levels(x):
        axis = x[3:6] / jnp.linalg.norm(x[3:6])
        tool = mill(name, x[6], x[7])
        return tool.level(points, x[:3], axis)

    x = jnp.asarray([*TIP, *random_axes(1, 2)[0], 2 * R, corner])
    steps = np.array([1e-8] * 3 + [1e-6] * 3 + [1e-8] * 2)
    found = jax.jacfwd(levels)(x)
    np.testing.assert_allclose(jax.jacrev(levels)(x), found, atol=1e-12)
    for i, h in enumerate(steps):
        s = np.zeros(8)
        s[i] = h
        wanted = (levels(x + s) - levels(x - s)) / (2 * h)
        np.testing.assert_allclose(found[:, i], wanted, atol=1e-5)


coordinate = st.floats(-20e-3, 20e-3)
place = st.tuples(coordinate, coordinate, coordinate)


@settings(max_examples=200, deadline=None)
@given(
    name=st.sampled_from(list(CORNERS)),
    first=place,
    second=place,
    share=st.floats(0, 1),
    seed=st.integers(0, 1000),
)
def test_level_is_convex(name, first, second, share, seed):
    axis = random_axes(1, seed)[0]
    p, q = np.array(first), np.array(second)
    points = np.stack([p, q, (1 - share) * p + share * q])
    at_p, at_q, between = mill(name).level(*arrays(points, TIP, axis))
    assert between <= (1 - share) * at_p + share * at_q + 1e-16
