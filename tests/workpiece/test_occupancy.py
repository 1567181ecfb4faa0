import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffmill import cutter as ct, workpiece as wp

MILL = ct.flat_end_mill(10e-3, 2)
DISCS = wp.Discs(4, 0.6e-3, 0.1e-3)
STOCK = wp.box([0, 0, -3e-3], [12e-3, 10e-3, 0], 0.2e-3)


@jax.jit
def seen_in(stock, points, moves):
    none = jnp.zeros_like(moves)
    return DISCS.occupancy(stock, points, moves, none, MILL)[0]


@jax.jit
def look(points):
    moves = jnp.full((points.shape[0], 1, 2), 1e-3)
    return seen_in(STOCK, points[:, None], moves)


def test_disc_shares_sum_to_the_depth_at_any_depth():
    depth = jnp.linspace(0, 2.0e-3, 57)
    total = jnp.sum(DISCS.filled_below(depth[None]), axis=0) * DISCS.height
    np.testing.assert_allclose(total, depth, atol=1e-15)
    assert not DISCS.filled_below(jnp.array([[-1e-4]])).any()


@pytest.mark.parametrize("depth", [0.13e-3, 0.6e-3, 1.0e-3, 1.47e-3])
def test_inside_the_stock_the_discs_sum_to_the_depth(depth):
    rng = np.random.default_rng(2)
    points = np.column_stack(
        [rng.uniform(2e-3, 10e-3, 50), rng.uniform(2e-3, 8e-3, 50), np.full(50, -depth)]
    )
    total = jnp.sum(look(jnp.asarray(points)), axis=-1) * DISCS.height
    np.testing.assert_allclose(total, depth, rtol=1e-5)


def test_the_wall_is_where_it_is_at_every_depth():
    y = np.linspace(-0.3e-3, 0.3e-3, 61)
    for depth in (0.5e-3, 1.0e-3):
        points = np.column_stack([np.full(61, 5.07e-3), y, np.full(61, -depth)])
        total = jnp.sum(look(jnp.asarray(points)), axis=-1) * DISCS.height / depth
        np.testing.assert_allclose(total[y < -0.11e-3], 0, atol=1e-4)
        np.testing.assert_allclose(total[y > 0.11e-3], 1, atol=1e-4)
        # The transition is centered on the wall: its integral is the right length.
        assert abs(np.trapezoid(total, y) - 0.3e-3) < 2e-6


def test_far_from_the_stock_everything_is_exactly_zero():
    points = jnp.array([[-1e-3, 5e-3, -1e-3], [5e-3, 5e-3, 0.1e-3], [50e-3, 0.0, 0.0]])
    value, grad = jax.value_and_grad(lambda p: jnp.sum(look(p)))(points)
    assert float(value) == 0
    np.testing.assert_array_equal(grad, 0)


def test_gradient_matches_differences():
    rng = np.random.default_rng(3)
    points = np.column_stack(
        [
            np.full(40, 5.07e-3),
            rng.uniform(-0.08e-3, 0.08e-3, 40),
            np.full(40, -1.03e-3),
        ]
    )
    weights = jnp.asarray(rng.normal(size=(40, DISCS.count)))

    def total(p):
        return jnp.sum(weights * look(p), axis=-1)

    points = jnp.asarray(points)
    _, slope = jax.jvp(total, (points,), (jnp.ones_like(points),))
    step = 1e-9
    difference = (total(points + step) - total(points - step)) / (2 * step)
    scale = float(jnp.max(jnp.abs(difference)))
    is_close = np.abs(slope - difference) < 1e-5 * scale
    assert scale > 1e3
    assert is_close.mean() >= 0.95


def spread(points, discs):
    """Return points on the rim, moves and chips, each disc with a copy of its own."""
    shape = (points.shape[0], discs.count, 3)
    moves = jnp.full((*shape[:2], 2), 1e-3)
    return jnp.broadcast_to(points[:, None], shape), moves, jnp.zeros_like(moves)


def test_discs_with_points_of_their_own_see_what_those_that_share_them_see():
    rng = np.random.default_rng(4)
    points = jnp.asarray(
        rng.uniform([-1e-3, -1e-3, -2e-3], [4e-3, 4e-3, 1e-4], (60, 3))
    )
    places, moves, _ = spread(points, DISCS)
    own = seen_in(STOCK, places, moves)
    assert float(own.max()) > 0.5
    np.testing.assert_allclose(own, look(points), atol=1e-14)


def test_work_grows_no_faster_than_the_number_of_discs():
    work = []
    for count in (12, 24):
        discs = wp.Discs(count, 0.1e-3, 0.1e-3)
        place = spread(jnp.full((30, 3), -1e-3), discs)
        run = jax.jit(
            lambda p, m, c, discs=discs: discs.occupancy(STOCK, p, m, c, MILL)[0]
        )
        cost = run.lower(*place).cost_analysis()
        assert cost is not None
        work.append(cost["flops"])
    assert work[1] < 2.1 * work[0]


def test_turning_from_across_a_wall_to_along_it_makes_no_kink():
    # Just inside the face y = 0, ways to the next sample in all directions.
    points = jnp.broadcast_to(jnp.array([5.07e-3, 24e-6, -1.03e-3]), (2001, 1, 3))
    turn = jnp.linspace(0, jnp.pi / 2, 2001)

    @jax.jit
    def total(turn):
        moves = 0.16e-3 * jnp.stack([jnp.cos(turn), jnp.sin(turn)], axis=-1)[:, None]
        none = jnp.zeros_like(moves)
        found = DISCS.occupancy(STOCK, points, moves, none, MILL)[0]
        return jnp.sum(found, axis=-1)

    slope = jax.jvp(total, (turn,), (jnp.ones_like(turn),))[1]
    assert jnp.abs(jnp.diff(slope)).max() < 0.03 * jnp.abs(slope).max()


@pytest.mark.parametrize("slope", [0.0, 0.4, -0.4])
def test_beside_a_wall_a_chip_is_as_thick_as_its_part_in_the_material(slope):
    # Samples at any phase go into the face y = 0; the chip is 1 + slope y / step there.
    step, count = 0.08e-3, 8
    phase = np.linspace(0, 1, 21)[:, None] + 0 * np.arange(2 * count)
    place = (phase + np.arange(-count, count)).reshape(-1)
    points = np.column_stack([0 * place + 5.07e-3, place * step, 0 * place - 1.03e-3])
    chip = 1 + slope * place
    moves = jnp.broadcast_to(jnp.array([0, step]), (len(place), 1, 2))
    found = DISCS.occupancy(
        STOCK,
        jnp.asarray(points)[:, None],
        moves,
        jnp.zeros_like(moves),
        MILL,
        growth=jnp.asarray(slope / np.maximum(chip, 0.1))[:, None],
    )
    force = jnp.sum(found.occupancy * found.chip_share, axis=-1) * chip
    total = force.reshape(phase.shape).sum(axis=1) * DISCS.height / 1.03e-3
    # Up to half a step behind the last; a hat is wider than a step by a 24th.
    end = phase[:, 0] + count - 0.5
    np.testing.assert_allclose(total, end + slope * (end**2 / 2 + 1 / 24), rtol=2e-4)


@jax.jit
def pocketed(x=6.07e-3, y=5.03e-3):
    """Return the block with a round hole of the mill, 1.3 mm deep, off the rays."""
    tip = jnp.array([[x, y, -1.33e-3]])
    window = wp.RemovalWindow.upright(STOCK, MILL, 2e-3, 0.4e-3)
    at = jnp.zeros(1, jnp.int32)
    cut = window.remove_poses(STOCK, MILL, wp.Pose(tip), at, jnp.ones(1, bool))
    return cut.stock


def near_the_rim(heights):
    """Return points within the band of the hole's rim, shape (point, 3)."""
    rng = np.random.default_rng(4)
    turn, radius = rng.uniform(0, 2 * np.pi, 300), rng.uniform(4.92e-3, 5.08e-3, 300)
    points = [6.07e-3 + radius * np.cos(turn), 5.03e-3 + radius * np.sin(turn)]
    return np.column_stack([*points, heights])


def beside_lines(points, axis, origin):
    """Return points just before and behind the grid lines nearest to them."""
    line = origin[axis] + 0.2e-3 * np.round((points[:, axis] - origin[axis]) / 0.2e-3)
    before, behind = points.copy(), points.copy()
    before[:, axis], behind[:, axis] = line - 1e-10, line + 1e-10
    return jnp.asarray(before), jnp.asarray(behind)


@pytest.mark.parametrize("axis", [0, 1])
def test_the_wall_does_not_jump_where_a_point_crosses_a_ray(axis):
    stock = pocketed()
    origin = np.asarray(stock.origin)
    points = near_the_rim(np.full(300, -1.03e-3))
    moves = jnp.full((300, 1, 2), 0.1e-3)
    before, behind = (
        seen_in(stock, p[:, None], moves) for p in beside_lines(points, axis, origin)
    )
    assert 0.05 < float(jnp.mean(before[:, 0])) < 0.95
    np.testing.assert_allclose(before, behind, atol=1e-4)


def test_a_column_that_a_cut_just_takes_or_leaves_at_a_slanting_wall_is_not_felt():
    # The rim passes a column, seen from the axis at an angle that no ray meets head-on.
    turn = np.radians(50)
    ray = np.asarray(STOCK.origin)[:2] + STOCK.spacing * np.array([40, 38])
    out = np.array([np.cos(turn), np.sin(turn)])
    before, after = (pocketed(*(ray - r * out)) for r in (5e-3 - 1e-10, 5e-3 + 1e-10))
    changed = after.families[2].ends != before.families[2].ends
    assert int(changed.any(axis=(2, 3)).sum()) == 1
    around = np.linspace(-0.06, 0.06, 61) + turn
    rim = ray - 5e-3 * out + 5e-3 * np.column_stack([np.cos(around), np.sin(around)])
    points = jnp.asarray(np.column_stack([rim, np.full(61, -1.33e-3)])[:, None])
    moves = jnp.full((61, 1, 2), 0.1e-3)
    left, taken = (seen_in(stock, points, moves) for stock in (before, after))
    np.testing.assert_allclose(taken, left, atol=1e-3)


def test_a_floor_below_a_dished_end_moves_with_the_pose_that_cut_it():
    stock = wp.box([0, 0, -5e-3], [14e-3, 14e-3, 0], 0.25e-3)
    window = wp.RemovalWindow.upright(stock, MILL, 3e-3, 0.5e-3)
    start = jnp.array([7.03e-3, 7.07e-3, -1e-3])
    # Over the floor, a millimetre deeper than its tip, and aside of the axis.
    point = jnp.array([[[9.1e-3, 7.3e-3, -2e-3]]])
    way = jnp.full((1, 1, 2), 1e-5)

    def cutter(sizes):
        diameter, angle = sizes
        return ct.flat_end_mill(diameter, 2, nominal_diameter=10e-3, dish_angle=angle)

    def cut(tip, sizes):
        poses, first = wp.Pose(tip[None]), jnp.zeros(1, jnp.int32)
        due = jnp.ones(1, bool)
        return window.remove_poses(stock, cutter(sizes), poses, first, due).stock

    def height(stock, sizes, track=None):
        found = DISCS.occupancy(stock, point, way, way, cutter(sizes), track=track)
        return jnp.sum(found.occupancy) * DISCS.height

    def by_track(tip, sizes):
        poses = wp.Pose(jnp.broadcast_to(tip, (2, 3)))
        return height(done, sizes, wp.PoseTrack(poses, 1))

    sizes = jnp.array([10e-3, 0.05])
    done = jax.jit(cut)(start, sizes)
    seen = jax.jit(lambda tip, sizes: height(cut(tip, sizes), sizes))
    at, ways = (start, sizes), ([1e-7] * 3, [1e-7, 1e-5])
    for i, steps in enumerate(ways):
        slopes = jax.jit(jax.jacfwd(by_track, argnums=i))(*at)
        for j, step in enumerate(steps):
            ends = []
            for sign in (-1, 1):
                moved = list(at)
                moved[i] = at[i].at[j].add(sign * step)
                ends.append(seen(*moved))
            found = float(ends[1] - ends[0]) / (2 * step)
            np.testing.assert_allclose(slopes[j], found, rtol=1e-6, atol=1e-7)
