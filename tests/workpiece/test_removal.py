import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffmill import cutter as ct, workpiece as wp
from diffmill.workpiece import Rays

MILL = ct.flat_end_mill(4e-3, 2)
subtract = jax.jit(lambda ends, poses, cut: cut.subtract_from(ends, poses))


def slots(pieces, count):
    ends = np.array([[Rays.DEAD] * count, [-Rays.DEAD] * count])
    for m, (low, high) in enumerate(pieces):
        ends[:, m] = low, high
    return ends


def python_subtract(pieces, start, stop):
    kept = []
    for low, high in pieces:
        for a, b in ((low, min(high, start)), (max(low, stop), high)):
            if b - a > 1e-9:
                kept.append((a, b))
    return kept


def live(ends):
    return sorted((a, b) for a, b in zip(ends[0], ends[1], strict=True) if b > a)


def test_subtracting_matches_a_loop_over_pieces():
    rng = np.random.default_rng(1)
    all_ends, cuts, wanted = [], [], []
    for _ in range(500):
        marks = np.sort(rng.uniform(0, 1, 6))
        pieces = [(marks[2 * i], marks[2 * i + 1]) for i in range(rng.integers(0, 4))]
        start, stop = np.sort(rng.uniform(-0.2, 1.2, 2))
        all_ends.append(slots(pieces, 5))
        cuts.append((start, stop))
        wanted.append(sorted(python_subtract(pieces, start, stop)))
    ends = jnp.asarray(np.stack(all_ends))
    start, stop = (jnp.asarray(np.array(c)) for c in zip(*cuts, strict=True))
    poses = jnp.full(ends.shape, -1, jnp.int32)
    started, stopped = (jnp.full(500, when, jnp.int32) for when in (7, 8))
    cut = wp.CutInterval(start, stop, jnp.ones(500, bool), started, stopped)
    found = subtract(ends, poses, cut)
    new, by = found.ends, found.cut_by
    assert not found.is_full.any()
    for i, pieces in enumerate(wanted):
        np.testing.assert_allclose(live(np.asarray(new[i])), pieces)
    # Ends that moved, and only those, carry the time of the end that moved them.
    is_live = np.asarray(new[:, 1] > new[:, 0])
    for side, value, when in ((0, stop, 8), (1, start, 7)):
        moved = np.asarray(new[:, side] == value[:, None]) & is_live
        assert (np.asarray(by[:, side])[moved] == when).all()
        assert (np.asarray(by[:, side])[~moved & is_live] == -1).all()


def test_a_ray_without_a_free_slot_raises_its_flag():
    ends = jnp.asarray(slots([(0.0, 1.0), (2.0, 3.0)], 2))[None]
    poses = jnp.full(ends.shape, -1, jnp.int32)
    yes = jnp.ones(1, bool)
    pose = jnp.zeros(1, jnp.int32)
    low, high, far = jnp.array([0.4]), jnp.array([0.6]), jnp.array([1.6])
    inside = wp.CutInterval(low, high, yes, pose, pose)
    assert subtract(ends, poses, inside).is_full.all()
    across = wp.CutInterval(low, far, yes, pose, pose)
    assert not subtract(ends, poses, across).is_full.any()


def test_slivers_are_dropped():
    ends = jnp.asarray(slots([(0.0, 1.0)], 2))[None]
    poses = jnp.full(ends.shape, -1, jnp.int32)
    pose = jnp.zeros(1, jnp.int32)
    low, high = jnp.array([0.5e-9]), jnp.array([0.5])
    cut = wp.CutInterval(low, high, jnp.ones(1, bool), pose, pose)
    new = subtract(ends, poses, cut).ends
    assert live(np.asarray(new[0])) == [(0.5, 1.0)]


@functools.cache
def cut_block(spacing):
    stock = wp.box([0, 0, -2e-3], [12e-3, 10e-3, 0], spacing)
    window = wp.RemovalWindow.upright(stock, MILL, 1.3e-3, 0.4e-3)

    def step(stock, x):
        tip, pose = x
        cut = window.remove_poses(
            stock, MILL, wp.Pose(tip[None]), pose[None], jnp.ones(1, bool)
        )
        return cut.stock, (cut.volume[0], cut.has_overflow | cut.has_left_window)

    tips = np.zeros((60, 3))
    tips[:, 0] = np.linspace(-3e-3, 8e-3, 60)
    tips[:, 1], tips[:, 2] = 5.03e-3, -1.07e-3
    xs = (jnp.asarray(tips), jnp.arange(60, dtype=jnp.int32))
    return stock, *jax.jit(lambda s: jax.lax.scan(step, s, xs))(stock), tips


def test_a_slot_has_its_exact_volume_and_every_step_counts():
    before, after, (volumes, is_bad), _ = cut_block(0.1e-3)
    assert not is_bad.any()
    removed = before.volume() - after.volume()
    np.testing.assert_allclose(jnp.sum(volumes), removed, rtol=1e-9)
    exact = (8e-3 * 4e-3 + np.pi * 2e-3**2 / 2) * 1.07e-3
    np.testing.assert_allclose(removed, exact, rtol=5e-3)


def test_no_ray_is_left_inside_any_pose_and_none_is_cut_outside():
    _, after, _, tips = cut_block(0.1e-3)
    for family in range(3):
        ends = after.ray_ends(family)
        # A point a hair inside the material must lie outside every pose.
        points, sign = ends.points.copy(), ends.signs
        points[:, family] -= sign * 1e-7
        away = points[:, None, :] - tips[None]
        inside = (np.hypot(away[..., 0], away[..., 1]) < 2e-3) & (away[..., 2] > 0)
        assert not inside.any()
        # A point a hair outside lies in a pose or outside the block.
        points[:, family] += sign * 2e-7
        away = points[:, None, :] - tips[None]
        inside = (np.hypot(away[..., 0], away[..., 1]) < 2e-3) & (away[..., 2] > 0)
        is_air = inside.any(axis=1)
        is_outside = (points < [0, 0, -2e-3]).any(1) | (points > [12e-3, 10e-3, 0]).any(
            1
        )
        assert (is_air | is_outside).all()


def remove_together(step, count=6):
    """Return a block before and after passes of some step [m] along x, and the rest."""
    stock = wp.box([0, 0, -2e-3], [12e-3, 10e-3, 0], 0.1e-3)
    window = wp.RemovalWindow.upright(stock, MILL, 1.3e-3, step * count)
    tips = jnp.asarray([[4e-3 + step * k, 5.03e-3, -1.07e-3] for k in range(count)])

    def pass_of(k):
        zero = jnp.zeros((), tips.dtype)
        along_x = jnp.asarray([1.0, 0.0])
        return wp.ToothPass(wp.Pose(tips[k][None]), k, along_x, zero, zero, 1)

    together = lambda stock: window.remove_together(
        stock, MILL, pass_of, jnp.asarray(count, jnp.int32), slots=stock.slots_in_use()
    )
    cut, taken = jax.jit(together)(stock)
    one_by_one = stock
    for k in range(int(taken)):
        due = jnp.ones(1, bool)
        k = jnp.asarray(k, jnp.int32)
        one_by_one = window.remove_passes(one_by_one, MILL, [pass_of(k)], due).stock
    return stock, cut, int(taken), one_by_one


def test_passes_that_overlap_go_together_but_for_scallops():
    step = 0.1e-3
    before, cut, taken, one_by_one = remove_together(step)
    assert taken == 6 and not (cut.has_overflow | cut.has_left_window)
    removed = before.volume() - cut.stock.volume()
    np.testing.assert_allclose(jnp.sum(cut.volume), removed, rtol=1e-9)
    # Between two circles a scallop of f^2 / (8 R) stays, along both sides of the slot.
    scallops = 2 * 5 * step * 1.07e-3 * step**2 / (8 * 2e-3)
    more = one_by_one.volume() - cut.stock.volume()
    assert -1e-9 * removed <= more <= scallops + 1e-6 * removed
    for family in range(3):
        here, there = cut.stock.ray_ends(family), one_by_one.ray_ends(family)
        # No scallop is as high as the rays are apart.
        assert len(here.points) <= len(there.points)
        if len(here.points) == len(there.points):
            np.testing.assert_allclose(here.points, there.points, atol=1e-12)


def test_passes_that_leave_something_between_them_go_one_by_one():
    before, cut, taken, one_by_one = remove_together(4.5e-3, count=2)
    assert taken == 1
    removed = before.volume() - cut.stock.volume()
    np.testing.assert_allclose(
        before.volume() - one_by_one.volume(), removed, rtol=1e-12
    )


def test_the_shank_takes_no_more_than_what_passes_before_have_left():
    mill = ct.flat_end_mill(4e-3, 2, flute_length=1e-3)
    stock = wp.box([0, 0, -2e-3], [8e-3, 8e-3, 0], 0.1e-3)
    window = wp.RemovalWindow.upright(stock, mill, 2e-3, 0.4e-3)
    tips = wp.Pose(jnp.array([[4e-3, 4e-3, -2e-3]] * 2 + [[4.3e-3, 4e-3, -2e-3]]))
    poses = jnp.arange(3, dtype=jnp.int32)
    cut = window.remove_poses(stock, mill, tips, poses, jnp.ones(3, bool))
    # The upper half of a cut 2 mm deep, whichever pass takes it.
    np.testing.assert_allclose(cut.by_shank, cut.volume / 2, rtol=1e-9, atol=1e-20)
    assert cut.volume[1] == 0 and cut.volume[2] > 0
    skipped = window.remove_poses(stock, mill, tips, poses, jnp.zeros(3, bool))
    assert not skipped.by_shank.any()


def test_a_tool_deeper_than_its_window_raises_the_flag():
    stock = wp.box([0, 0, -4e-3], [8e-3, 8e-3, 0], 0.2e-3)
    window = wp.RemovalWindow.upright(stock, MILL, 0.4e-3, 0.2e-3)
    tip = jnp.array([[4e-3, 4e-3, -3e-3]])
    yes, pose = jnp.ones(1, bool), jnp.zeros(1, jnp.int32)
    assert window.remove_poses(stock, MILL, wp.Pose(tip), pose, yes).has_left_window
    away = wp.Pose(tip + 10.0)
    assert not window.remove_poses(stock, MILL, away, pose, yes).has_left_window


@pytest.mark.parametrize(("at", "misses"), [(4.1e-3, False), (5.7e-3, True)])
def test_a_second_pose_that_reaches_out_of_the_window_raises_the_flag(at, misses):
    stock = wp.box([0, 0, -2e-3], [20e-3, 20e-3, 0], 0.2e-3)
    window = wp.RemovalWindow.upright(stock, MILL, 1e-3, 0.1e-3)
    tips = wp.Pose(jnp.array([[4e-3, 4e-3, -1e-3], [at, 4e-3, -1e-3]]))
    poses = jnp.arange(2, dtype=jnp.int32)
    cut = window.remove_poses(stock, MILL, tips, poses, jnp.ones(2, bool))
    assert cut.has_left_window == misses
    first = window.remove_poses(stock, MILL, tips, poses, jnp.array([True, False]))
    assert not first.has_left_window


@pytest.mark.parametrize("at", [6.1e-3, 13.9e-3])
def test_a_tool_wider_than_its_window_raises_the_flag(at):
    """A draw of the diameter may be far from the one that sized the windows."""
    stock = wp.box([0, 0, -2e-3], [20e-3, 20e-3, 0], 0.2e-3)
    pose = wp.Pose(jnp.array([[at, 10e-3, -1e-3]]))
    index, yes = jnp.zeros(1, jnp.int32), jnp.ones(1, bool)
    for diameter, misses in ((4e-3, False), (4.2e-3, False), (6e-3, True)):
        mill = ct.flat_end_mill(diameter, 2, nominal_diameter=4e-3)
        window = wp.RemovalWindow.upright(stock, mill, 1e-3, 0.1e-3)
        cut = window.remove_poses(stock, mill, pose, index, yes)
        assert cut.has_left_window == misses
        exact = np.pi / 4 * diameter**2 * 1e-3
        assert misses == (cut.volume[0] < 0.98 * exact)
