"""Removal by random tools at random poses: what must hold whatever they are."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings, strategies as st

from diffmill import cutter as ct, workpiece as wp

R, D = 2e-3, 0.25e-3
LOWER, UPPER = np.array([0.0, 0, -5e-3]), np.array([10e-3, 9e-3, 0.0])
COUNT = 3
# Whole grid: the tools point anywhere.
MILLS = {
    "flat": ct.flat_end_mill(2 * R, 2),
    "ball": ct.ball_end_mill(2 * R, 2),
    "bull": ct.bull_nose(2 * R, 2, 0.6e-3),
}
STOCK = wp.box(LOWER, UPPER, D, interval_counts=(5, 5, 5))
THIN = wp.box(LOWER, UPPER, D, interval_counts=(1, 1, 1))
quick = settings(max_examples=25, deadline=None, derandomize=True)


@functools.cache
def remover(kind):
    window = wp.RemovalWindow.tilted(STOCK, MILLS[kind], None, 5e-3, D)
    index, yes = jnp.zeros(1, jnp.int32), jnp.ones(1, bool)

    def one(stock, tip, axis):
        pose = wp.Pose(tip[None], axis[None])
        cut = window.remove_poses(stock, MILLS[kind], pose, index, yes)
        return cut.stock, cut.volume[0], cut.stock.volumes(), cut.has_overflow

    return jax.jit(one)


def remove(kind, stock, poses):
    """Return the stock, and by pose what is removed, what is left, and the flags."""
    rows = []
    for tip, axis in poses:
        stock, *row = remover(kind)(stock, jnp.asarray(tip), jnp.asarray(axis))
        rows.append(row)
    return stock, *(np.array(column) for column in zip(*rows, strict=True))


def coordinates(low, high):
    return st.tuples(*(st.floats(a, b) for a, b in zip(low, high, strict=True)))


def unit(vector):
    vector = np.asarray(vector)
    length = np.linalg.norm(vector)
    return vector / length if length > 1e-3 else np.array([0.0, 0, 1])


kinds = st.sampled_from(sorted(MILLS))
tips = coordinates(LOWER - R, UPPER + R).map(np.array)
axes = coordinates([-1.0] * 3, [1.0] * 3).map(unit)
poses = st.lists(st.tuples(tips, axes), min_size=COUNT, max_size=COUNT)


@given(kinds, poses)
@quick
def test_volume_never_grows_and_every_step_is_counted(kind, poses):
    stock, removed, volumes, full = remove(kind, STOCK, poses)
    before = np.vstack([STOCK.volumes(), volumes])
    assert not full.any()
    assert (np.diff(before, axis=0) <= 1e-20).all()
    assert (np.asarray(volumes) >= 0).all()
    # Family by family, and in the estimate that the steps report.
    lost = -np.diff(before @ np.array(STOCK.volume_weights))
    np.testing.assert_allclose(removed, lost, rtol=1e-9, atol=1e-20)
    np.testing.assert_allclose(stock.volumes(), volumes[-1], rtol=1e-12)
    for rays in stock.families:
        low, high = rays.ends[:, :, 0], rays.ends[:, :, 1]
        length = jnp.where(high > low, high - low, 1.0)
        assert float(length.min()) > 0.9e-9


@given(kinds, poses)
@quick
def test_a_second_time_nothing_is_left_to_remove(kind, poses):
    stock, *_ = remove(kind, STOCK, poses)
    again, removed, *_ = remove(kind, stock, poses)
    np.testing.assert_allclose(removed, 0, atol=1e-16)
    np.testing.assert_allclose(again.volumes(), stock.volumes(), rtol=1e-9)


@given(kinds, kinds, axes, axes, st.floats(0, 1))
@quick
def test_the_order_of_cuts_far_apart_does_not_matter(one, other, axis_1, axis_2, at):
    # Tools that point away from each other, from tips in opposite halves.
    axis_1, axis_2 = (
        unit([s * (abs(a[0]) + 0.3), a[1], a[2]])
        for s, a in ((-1, axis_1), (1, axis_2))
    )
    left, right = np.array([2e-3, 4e-3, -2e-3]), np.array([8e-3, 4e-3, -2e-3])
    left, right = left + at * 1e-3 * axis_1, right + at * 1e-3 * axis_2
    cuts = [
        (one, [(left, axis_1)]),
        (other, [(right, axis_2)]),
    ]
    results = []
    for order in (cuts, cuts[::-1]):
        stock, volumes = STOCK, {}
        for kind, where in order:
            stock, removed, *_ = remove(kind, stock, where)
            volumes[where[0][0][0]] = removed[0]
        results.append((stock, volumes))
    (first, gone), (second, gone_too) = results
    for key, volume in gone.items():
        np.testing.assert_allclose(gone_too[key], volume, rtol=1e-9, atol=1e-18)
    for a, b in zip(first.families, second.families, strict=True):
        np.testing.assert_array_equal(sorted_ends(a), sorted_ends(b))


def sorted_ends(rays):
    return np.sort(np.asarray(rays.ends), axis=-1)


@given(coordinates([3e-3, 3e-3, -4e-3], [7e-3, 6e-3, -2e-3]), st.integers(0, 2))
@quick
def test_a_ray_without_a_slot_always_raises_the_flag(tip, family):
    # A ball inside the block parts every ray that it meets; only its shank, along the
    # axis, leaves the block. One slot cannot hold both parts.
    axis = np.eye(3)[(family + 1) % 3]
    cut = [(np.array(tip), axis)]
    stock, _, _, full = remove("ball", THIN, cut)
    assert bool(full[0])
    roomy, _, _, full = remove("ball", STOCK, cut)
    assert not bool(full[0])
    # With room, the same cut takes no more than without.
    assert float(roomy.volume()) >= float(stock.volume()) - 1e-20


@given(kinds, st.tuples(coordinates(LOWER, UPPER).map(np.array), axes))
@quick
def test_the_families_agree(kind, pose):
    _, _, volumes, _ = remove(kind, STOCK, [pose])
    removed = np.asarray(STOCK.volumes() - volumes[0])
    # Each misses or adds less than half a spacing over the tool's surface in the block,
    # and most of that cancels.
    surface = 2 * np.pi * R * 14e-3
    assert np.ptp(removed) < 0.1 * D * surface
