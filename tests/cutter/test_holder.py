"""The holder against the definition of its cylinders and cones, point by point."""

import jax.numpy as jnp
import numpy as np
import pytest

import diffmill.cutter as ct

# A nose, a cone that widens and one that narrows [m].
PARTS = [(0.020, 0.020, 0.015), (0.024, 0.050, 0.010), (0.050, 0.030, 0.020)]
LOWER, UPPER, LENGTHS = zip(*PARTS, strict=True)
HOLDER = ct.ToolHolder.from_sizes(0.040, LOWER, LENGTHS, upper_diameters=UPPER)


def depth_of_points(points, tip, axis):
    """Return the depth by definition: from the side and the lower face of a part."""
    along = (points - tip) @ axis
    rho = np.linalg.norm(points - tip - along[:, None] * axis, axis=1)
    deepest, foot = np.zeros(len(points)), HOLDER.overhang
    for low, high, length in PARTS:
        up = along - foot
        slope = (high - low) / 2 / length
        side = (low / 2 + slope * up - rho) * np.cos(np.arctan(slope))
        is_in = (up > 0) & (up < length) & (side > 0)
        deepest = np.maximum(deepest, np.where(is_in, np.minimum(up, side), 0))
        foot += length
    return deepest


@pytest.mark.parametrize(
    "axis",
    [
        (0, 0, 1),
        (0, 0.6, 0.8),
        (1, 0, 0),
        (0, 0.8, -0.6),
        (1e-4, 0, 1),
        (0.48, 0.6, 0.64),
    ],
)
@pytest.mark.parametrize("family", [0, 2])
def test_short_pieces_have_the_depth_of_their_point(axis, family):
    rng = np.random.default_rng(1)
    axis = np.array(axis) / np.linalg.norm(axis)
    tip = np.array([0.003, -0.002, 0.001])
    points = tip + 0.06 * axis + rng.uniform(-0.03, 0.03, (4000, 3))
    wanted = depth_of_points(points, tip, axis)
    assert 200 < (wanted > 0).sum() < 3800
    t = points[:, family]
    found = HOLDER.depth_in_pieces(
        family,
        jnp.asarray(points[:, (family + 1) % 3]),
        jnp.asarray(points[:, (family + 2) % 3]),
        jnp.asarray([t - 1e-9, t + 1e-9]),
        jnp.asarray(tip),
        jnp.asarray(axis),
    )
    np.testing.assert_allclose(found, wanted, rtol=0, atol=5e-9)


def test_long_pieces_are_found_where_a_point_of_them_is_inside():
    rng = np.random.default_rng(2)
    axis = np.array([0.0, 0.6, 0.8])
    tip = np.zeros(3)
    x, y = rng.uniform(-0.05, 0.05, 300), rng.uniform(-0.02, 0.1, 300)
    z = np.linspace(0, 0.1, 4001)
    found = HOLDER.depth_in_pieces(
        2,
        jnp.asarray(x),
        jnp.asarray(y),
        jnp.stack([jnp.zeros(300), jnp.full(300, 0.1)]),
        jnp.asarray(tip),
        jnp.asarray(axis),
    )
    for i in range(300):
        points = np.stack([np.full_like(z, x[i]), np.full_like(z, y[i]), z], axis=-1)
        deepest = depth_of_points(points, tip, axis).max()
        assert (found[i] > 1e-4) <= (deepest > 0) and (deepest > 1e-4) <= (found[i] > 0)
        assert found[i] <= deepest + 2e-5


def test_pieces_that_are_none_hold_nothing():
    zero = jnp.zeros(1)
    none = jnp.stack([zero + 1e3, zero - 1e3])
    found = HOLDER.depth_in_pieces(
        2, zero, zero, none, jnp.zeros(3), jnp.asarray([0.0, 0, 1])
    )
    assert float(found[0]) == 0


@pytest.mark.parametrize(
    ("overhang", "upper", "lengths", "name"),
    [
        (0.0, [0.02], [0.01], "overhang"),
        (0.04, [], [], "parts"),
        (0.04, [-0.02], [0.01], "upper_diameter"),
        (0.04, [0.02], [float("inf")], "length"),
    ],
)
def test_impossible_holders_are_refused(overhang, upper, lengths, name):
    lower = [0.02] * len(lengths)
    with pytest.raises(ValueError, match=f"`{name}`"):
        ct.ToolHolder.from_sizes(overhang, lower, lengths, upper_diameters=upper)


def test_parts_without_an_upper_diameter_are_cylinders():
    holder = ct.ToolHolder.from_sizes(0.04, [0.02, 0.03], [0.01, 0.02])
    assert [part.upper_diameter for part in holder.parts] == [0.02, 0.03]
    with pytest.raises(ValueError, match="`lengths`"):
        ct.ToolHolder.from_sizes(0.04, [0.02, 0.03], [0.01])
