import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import PAPER_LAW, ThroughSamples, assert_adjoints_agree, relative
from references import circles

from diffmill import RESULTS, cutter as ct, process as pr, sim, workpiece as wp
from diffmill.cutting import KienzleLaw, LinearEdgeLaw

MILL = ct.flat_end_mill(10e-3, 2)
D = 0.2e-3
STOCK = wp.box([0, 0, -3e-3], [16e-3, 12e-3, 0], D, interval_counts=(4, 4, 1))
SPEED = 8000 * 2 * math.pi / 60
FEED = 0.1875e-3
SLOW = pytest.mark.slow
STEPS = 110


@functools.cache
def compiled():
    @jax.jit
    def run(positions, stock, law):
        return sim.simulate_process(
            positions, stock, MILL, law, SPEED, axial_depth=1.6e-3
        )

    return lambda positions, stock, law=PAPER_LAW: run(positions, stock, law)


@functools.cache
def force_and_change():
    """Return a program of the force along a path and its change along a direction."""
    run = lambda path: compiled()(path, STOCK).force
    return jax.jit(lambda path, along: jax.jvp(run, (path,), (along,)))


def stopping(path):
    """Return the path with a tool that stands still behind its end."""
    return path[np.minimum(np.arange(STEPS), len(path) - 1)]


def line(start, stop, steps=STEPS):
    return np.linspace(np.asarray(start), np.asarray(stop), steps)


def straight(y, depth=1.0e-3, feed=FEED, steps=STEPS):
    x = -6e-3 + feed * np.arange(steps)
    return np.column_stack([x, np.full(steps, y), np.full(steps, -depth)])


def steady(solution):
    # The path ends with the tool leaving the stock; before that the cut is steady.
    return np.asarray(solution.force)[70:90].mean(axis=0)


def test_a_slot_pushes_the_tool_back_and_to_the_side():
    # Feed along +x, clockwise cutter: the force on the tool is against the feed, to
    # +y (Altintas' slot), and K_ac > 0 lifts it.
    F = steady(compiled()(straight(6e-3), STOCK))
    assert F[0] < 0 < F[1] and F[2] > 0
    wanted = circles.mean_force(PAPER_LAW, circles.Cut(FEED, 10e-3), 1e-3)
    assert relative(F, wanted) < 2e-3


@pytest.mark.parametrize("radial_depth", [5e-3, 2e-3, 1e-3, 0.5e-3, 0.1e-3])
def test_partial_cuts_match_the_quadrature(radial_depth):
    # Tooth at phi = 0 looks to +y: stock beside +y is up-milling.
    solution = compiled()(straight(-(5e-3 - radial_depth)), STOCK)
    wanted = circles.mean_force(PAPER_LAW, circles.Cut(FEED, radial_depth), 1e-3)
    assert relative(steady(solution), wanted) < 5e-3


def test_down_milling_matches_the_quadrature():
    solution = compiled()(straight(12e-3 + 3e-3), STOCK)
    cut = circles.Cut(FEED, 2e-3, is_up_milling=False)
    wanted = circles.mean_force(PAPER_LAW, cut, 1e-3)
    assert relative(steady(solution), wanted) < 5e-3


def test_the_force_does_not_jump_where_teeth_change_places():
    # A finishing cut leaves at the end of the half turn, where the next tooth comes.
    level = straight(17e-3 - 0.2e-3)
    rise = np.linspace(-1e-9, 1e-9, STEPS)[:, None] * [0, 0, 1]
    up, down = (compiled()(level + s * rise, STOCK).force for s in (1, -1))
    assert jnp.abs(up - down).max() < 1e-3


def test_a_straight_path_lies_on_no_kink():
    # Its samples stand at fixed distances from where teeth change, here in material.
    path = straight(0.01e-3)
    wave = np.sin(2 * np.arange(STEPS))[:, None] * [0, 1, 0]
    step = 1e-8
    left, middle, right = (
        jnp.sum(compiled()(path + s * wave, STOCK).force * wave)
        for s in (-step, 0, step)
    )
    assert abs(left - 2 * middle + right) < 1e-3 * abs(right - left)


@SLOW
def test_the_slope_on_the_floor_cut_before_is_that_of_differences():
    # Lifted alone, the first row leaves the floor on which the path began, or digs in.
    path = np.array([4e-3, 6.01e-3, -1e-3]) + FEED * np.arange(3)[:, None] * [1, 0, 0]
    plan = pr.choose_engagement(STOCK, MILL, axial_depth=1.6e-3, has_bottom=False)

    @jax.jit
    def side(rise):
        lifted = path + rise * jnp.zeros((3, 3)).at[1, 2].set(1)
        run = sim.simulate_process(
            lifted, STOCK, MILL, PAPER_LAW, SPEED, engagement=plan
        )
        return run.force[1, 1]

    _, found = jax.jvp(side, (0.0,), (1.0,))
    wanted = (side(10e-6) - side(-10e-6)) / 20e-6
    np.testing.assert_allclose(found, wanted, rtol=0.02)


def test_contact_is_fair_at_any_angle_between_feed_and_samples():
    # Edge forces alone, along the feed and across it, of slots in turned directions.
    law = LinearEdgeLaw(0.0, 0.0, 0.0, 1e4, 2e4, 0.0)
    found = []
    for turn in 2 * math.pi / 192 * np.array([0.0, 0.25, 0.5, 0.75]):
        along = np.array([math.cos(turn), math.sin(turn), 0.0])
        path = np.array([8e-3, 6e-3, -1e-3]) + FEED * np.arange(8)[:, None] * along
        path = path - 7 * FEED * along
        F = compiled()(stopping(path), STOCK, law).force[5:8].mean(axis=0)
        found.append([F @ along, along[0] * F[1] - along[1] * F[0]])
    assert np.ptp(found, axis=0).max() < 2e-3 * np.abs(found).max()


def test_turning_the_feed_turns_the_force():
    along_x = steady(compiled()(straight(6e-3), STOCK))
    y = -6e-3 + FEED * np.arange(STEPS)
    path = np.column_stack([np.full(STEPS, 8e-3), y, np.full(STEPS, -1e-3)])
    along_y = np.asarray(compiled()(path, STOCK).force)[45:60].mean(axis=0)
    # A quarter turn counterclockwise maps x to y.
    assert relative(along_y, [-along_x[1], along_x[0], along_x[2]]) < 2e-3


@pytest.mark.parametrize("depth", [0.27e-3, 0.61e-3, 0.93e-3, 1.31e-3])
def test_force_is_linear_in_the_axial_depth(depth):
    F = steady(compiled()(straight(6e-3, depth), STOCK))
    one = circles.mean_force(PAPER_LAW, circles.Cut(FEED, 10e-3), 1e-3)
    np.testing.assert_allclose(
        np.linalg.norm(F), np.linalg.norm(one) * depth / 1e-3, rtol=5e-3
    )


def test_every_removed_volume_is_counted():
    steps = 85
    path = stopping(straight(6.03e-3, 1.07e-3, steps=steps))
    solution = compiled()(path, STOCK)
    removed = STOCK.volume() - solution.stock.volume()
    total = jnp.sum(solution.removed_volume) + solution.initial_overlap_volume
    np.testing.assert_allclose(total, removed, rtol=1e-9)
    length = -6e-3 + FEED * (steps - 1)
    exact = (length * 10e-3 + math.pi * 5e-3**2 / 2) * 1.07e-3
    np.testing.assert_allclose(removed, exact, rtol=5e-3)
    assert bool(solution.result == RESULTS.successful)


def test_starting_in_the_stock_is_an_overlap_and_no_chip():
    path = line([8e-3, 6e-3, -1e-3], [8e-3, 6e-3, -1e-3])
    solution = compiled()(path, STOCK)
    np.testing.assert_allclose(
        solution.initial_overlap_volume, math.pi * 5e-3**2 * 1e-3, rtol=1e-2
    )
    np.testing.assert_array_equal(solution.force, 0)
    np.testing.assert_array_equal(solution.removed_volume, 0)


@pytest.mark.slow
def test_in_the_air_force_and_gradient_are_exactly_zero():
    path = jnp.asarray(straight(6e-3, -0.1e-3))

    def total(p):
        return jnp.sum(compiled()(p, STOCK).force ** 2)

    value, grad = jax.value_and_grad(total)(path)
    assert float(value) == 0
    np.testing.assert_array_equal(grad, 0)


def test_the_second_pass_cuts_nothing():
    steps = STEPS // 2
    first = straight(6e-3, feed=2 * FEED, steps=steps)
    solution = compiled()(np.concatenate([first, first[::-1]]), STOCK)
    F = np.linalg.norm(np.asarray(solution.force), axis=1)
    assert F[steps + 15 :].max() < 0.02 * F[:steps].max()
    np.testing.assert_allclose(solution.removed_volume[steps + 1 :], 0, atol=1e-15)


@pytest.mark.slow
def test_where_the_tool_comes_to_rest_the_derivative_is_that_over_micrometres():
    # The direction of a motion of 20 nm turns with every nanometre: a derivative that
    # says so tells nothing about the micrometres by which a path is corrected.
    path = straight(6e-3)
    path[70:, 0] = path[69, 0] + 2e-8 * np.arange(1, STEPS - 69)
    # The tool goes aside and stays there.
    aside = np.zeros_like(path)
    aside[75:, 1] = 1.0
    slope = force_and_change()(path, aside)[1]
    step = 2e-6
    ends = [compiled()(path + s * step * aside, STOCK).force for s in (1, -1)]
    change = (ends[0] - ends[1]) / (2 * step)
    size = np.max(np.linalg.norm(np.asarray(change), axis=1))
    assert np.max(np.linalg.norm(np.asarray(slope), axis=1)) < 2 * size


def test_a_cutter_may_be_an_argument_of_a_compiled_program():
    # What sizes arrays is part of a tree's structure, so that it is never traced.
    path = straight(6e-3)
    force = lambda mill, x: (
        sim.simulate_process(x, STOCK, mill, PAPER_LAW, SPEED, axial_depth=1.6e-3).force
    )
    wanted = compiled()(path, STOCK).force
    np.testing.assert_allclose(jax.jit(force)(MILL, path), wanted, rtol=1e-9, atol=1e-9)


def with_rapid_moves():
    """Return a path that comes and goes by millimetres a row."""
    path = straight(6e-3)
    path[:40, 0] = -6e-3 - 3e-3 * np.arange(40)[::-1]
    path[60:] += [0, 0, 4e-3]
    return path


def test_rapid_moves_of_millimetres_give_finite_derivatives():
    path = with_rapid_moves()
    along = np.random.default_rng(3).normal(size=path.shape)
    force, change = force_and_change()(path, along)
    assert np.isfinite(force).all() and np.isfinite(change).all()


@SLOW
def test_rapid_moves_of_millimetres_give_finite_gradients():
    total = lambda path: jnp.sum(compiled()(path, STOCK).force)
    gradient = jax.grad(total)(jnp.asarray(with_rapid_moves()))
    assert np.isfinite(gradient).all()


@functools.cache
def with_one_slot():
    """Return a program that cuts a block with a single interval on each ray."""
    stock = wp.box([0, 0, -3e-3], [16e-3, 12e-3, 0], D, interval_counts=(1, 1, 1))
    return jax.jit(
        lambda p: sim.simulate_process(
            p, stock, MILL, PAPER_LAW, SPEED, axial_depth=1.6e-3
        )
    )


def test_too_few_slots_raise_the_flag_where_they_are_too_few():
    found = with_one_slot()(straight(6e-3))
    assert bool(found.result == RESULTS.interval_overflow)
    # The tool meets the stock in row 6; a cut is removed up to 2 mm later.
    first = int(np.argmax(found.has_failed))
    assert 6 <= first <= 6 + math.ceil(2e-3 / FEED)


@SLOW
def test_too_few_slots_raise_the_flag_in_the_last_row_at_the_latest():
    # So few steps that all is removed at the end: the last one has it.
    first = int(np.argmax(with_one_slot()(straight(6e-3)).has_failed))
    short = with_one_slot()(straight(6e-3)[: first - 1])
    assert bool(short.result == RESULTS.interval_overflow)
    assert int(np.argmax(short.has_failed)) == first - 2


def test_a_deeper_cut_than_promised_raises_the_flag():
    assert bool(
        compiled()(straight(6e-3, 2.9e-3), STOCK).result == RESULTS.window_overflow
    )


@pytest.mark.slow
def test_helix_keeps_the_mean_and_spreads_the_extremes():
    helical = ct.flat_end_mill(10e-3, 2, math.radians(30))
    run = lambda mill: jax.jit(
        lambda p: (
            sim.simulate_process(
                p,
                STOCK,
                mill,
                PAPER_LAW,
                SPEED,
                axial_depth=1.6e-3,
                keeps_instantaneous=True,
            ).instantaneous_force
        )
    )(straight(6e-3))[70:90]
    straight_flutes, with_helix = np.asarray(run(MILL)), np.asarray(run(helical))
    assert relative(with_helix.mean((0, 1)), straight_flutes.mean((0, 1))) < 5e-3
    assert np.ptp(with_helix[..., 1]) < np.ptp(straight_flutes[..., 1])


HIGH = wp.box([0, -3e-3, -6e-3], [4e-3, 3e-3, 0], 0.25e-3, interval_counts=(2, 2, 1))
STEEP = math.radians(45)


def cut_high(path, helix_angle):
    """Return the run of a thin tool, whose helix turns by half on the way up."""
    mill = ct.flat_end_mill(4e-3, 2, helix_angle)
    plan = pr.choose_engagement(
        HIGH, mill, axial_depth=6e-3, angles=16, element_height=6e-3
    )
    return sim.simulate_process(path, HIGH, mill, PAPER_LAW, SPEED, engagement=plan)


@functools.cache
def compiled_high():
    return jax.jit(cut_high)


def walls(run, mirror=1):
    """Return the points of a slot's walls, ordered by height, way and side."""
    assert run.result == RESULTS.successful
    points = run.stock.ray_ends(1).points * [1, mirror, 1]
    is_wall = (np.abs(points[:, 1]) < 2.9e-3) & (np.abs(points[:, 0] - 2e-3) < 1e-3)
    x, y, z = points[is_wall].T
    return points[is_wall][np.lexsort((y, x, z))]


@pytest.mark.parametrize("is_traced", [True, False], ids=["traced", "known"])
def test_a_left_hand_helix_leaves_the_mirror_image_of_a_right_hand_one(is_traced):
    step = np.arange(90)
    shake = 40e-6 * np.sin(0.6 * math.pi * step + 0.4)
    path = np.column_stack([-2.4e-3 + 0.1e-3 * step, shake, np.full(90, -5.9e-3)])
    right = walls(compiled_high()(path, STEEP))
    # In a mirror a tool turns the other way: so time runs backward there as well.
    back = path[::-1] * [1, -1, 1]
    known = jax.jit(lambda path: cut_high(path, -STEEP))
    run = compiled_high()(back, -STEEP) if is_traced else known(back)
    np.testing.assert_allclose(walls(run, mirror=-1), right, atol=0.1e-6)
    # Its walls are not the same at all heights.
    assert np.ptp(right[right[:, 1] > 0, 1]) > 15e-6


def cut(path, adjoint, stock=STOCK):
    """Return a run that is differentiated in a given way."""
    return sim.simulate_process(
        path, stock, MILL, PAPER_LAW, SPEED, axial_depth=1.6e-3, adjoint=adjoint
    )


def in_two_steps():
    """Return a path along a wall and, deeper, back: its walls have two ages."""
    count = STEPS // 2
    there = straight(-2.5e-3, 0.6e-3, feed=2 * FEED, steps=count)
    return np.concatenate([there, straight(-2e-3, 1.03e-3, 2 * FEED, count)[::-1]])


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["forward", "reverse"])
@pytest.mark.parametrize("path", [straight(-2e-3, 1.03e-3), in_two_steps()])
def test_all_adjoints_agree(mode, path):
    path = jnp.asarray(path)
    rng = np.random.default_rng(4)
    weights = jnp.asarray(rng.normal(size=path.shape))
    direction = jnp.asarray(rng.normal(size=path.shape))

    def derivative(adjoint):
        total = lambda p: jnp.sum(weights * cut(p, adjoint).force)
        if mode == "reverse":
            return jax.jit(jax.grad(total))(path)
        return jax.jit(lambda p: jax.jvp(total, (p,), (direction,))[1])(path)

    assert_adjoints_agree(derivative)


@pytest.mark.slow
def test_ends_of_an_earlier_run_are_raw_to_the_next():
    first = compiled()(straight(-2e-3, 1.03e-3), STOCK).stock
    path, aside = straight(-1.6e-3, 1.03e-3), np.tile([0.0, 1.0, 0.0], (STEPS, 1))

    def slope(adjoint, stock):
        force = lambda p: cut(p, adjoint, stock).force
        return jax.jit(lambda p: jax.jvp(force, (p,), (aside,))[1])(path)

    plain = slope(ThroughSamples(), first)
    scale = np.abs(plain).max()
    for stock in (first, first.as_raw()):
        found = slope(pr.ThroughRays(), stock)
        np.testing.assert_allclose(found, plain, rtol=1e-9, atol=1e-9 * scale)


@pytest.mark.slow
@pytest.mark.parametrize("way", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
def test_all_adjoints_agree_on_the_origin(way):
    def slope(adjoint):
        def force(origin):
            stock = eqx.tree_at(lambda s: s.origin, STOCK, origin)
            return cut(straight(-2e-3, 1.03e-3), adjoint, stock).force

        moved = lambda x: jax.jvp(force, (x,), (jnp.array(way),))[1]
        return jax.jit(moved)(STOCK.origin)

    assert_adjoints_agree(slope, pr.ThroughRays())


@pytest.mark.slow
def test_volumes_are_differentiated_through_the_rays():
    path = jnp.asarray(straight(-2e-3, 1.03e-3))
    weights = jnp.asarray(np.random.default_rng(7).normal(size=STEPS))

    def gradient(adjoint):
        total = lambda p: jnp.sum(weights * cut(p, adjoint).removed_volume)
        return jax.jit(jax.grad(total))(path)

    assert_adjoints_agree(gradient, pr.ThroughRays(), atol=0)
    np.testing.assert_array_equal(gradient(pr.ThroughPoses()), 0)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["forward", "reverse"])
def test_all_adjoints_agree_on_the_raw_stock(mode):
    # Two pieces on a ray, so that a raw end changes its slot where one is split.
    rays = STOCK.families
    ends = rays[0].ends.at[:, :, 1, 0].set(7e-3)
    ends = ends.at[:, :, :, 1].set(jnp.array([7.5e-3, 16e-3]))
    ends = jnp.where(rays[0].ends[:, :, 1:, :1] > 0, ends, rays[0].ends)
    start = (ends, *(r.ends for r in rays[1:]))
    rng = np.random.default_rng(5)
    path = jnp.asarray(straight(-2e-3, 1.03e-3))
    weights = jnp.asarray(rng.normal(size=path.shape))
    # Only ends of material move.
    along = tuple(
        jnp.where(x[:, :, 1:] > x[:, :, :1], jnp.asarray(rng.normal(size=x.shape)), 0)
        for x in start
    )

    def derivative(adjoint):
        def total(ends):
            families = tuple(
                wp.Rays(x, r.poses) for x, r in zip(ends, rays, strict=True)
            )
            stock = eqx.tree_at(lambda s: s.families, STOCK, families)
            return jnp.sum(weights * cut(path, adjoint, stock).force)

        if mode == "reverse":
            gradient = jax.jit(jax.grad(total))(start)
            return np.concatenate([np.ravel(x) for x in gradient])
        return np.asarray(jax.jit(lambda e: jax.jvp(total, (e,), (along,))[1])(start))

    assert_adjoints_agree(derivative)


@pytest.mark.slow
def test_reverse_mode_is_the_transpose_of_forward_mode_for_a_helix():
    # All columns under the tool end at one height, and so tie exactly.
    mill = ct.flat_end_mill(5e-3, 2, helix_angle=math.radians(30), flute_length=20e-3)
    stock = wp.box([0, 0, -4e-3], [12e-3, 9e-3, 0], 0.3e-3)
    plan = pr.choose_engagement(stock, mill, axial_depth=1.3e-3, substeps=2, angles=48)
    path = jnp.asarray(straight(4.5e-3, feed=0.2e-3, steps=12))
    path = path.at[:, 0].add(9e-3)
    rng = np.random.default_rng(4)
    weights, direction = jnp.asarray(rng.normal(size=(2, *path.shape)))

    def force(p):
        return sim.simulate_process(
            p, stock, mill, PAPER_LAW, SPEED, engagement=plan
        ).force

    forward = jax.jit(lambda p: jax.jvp(force, (p,), (direction,))[1])(path)
    reverse = jax.jit(lambda p: jax.vjp(force, p)[1](weights)[0])(path)
    np.testing.assert_allclose(
        jnp.sum(reverse * direction), jnp.sum(weights * forward), rtol=1e-9
    )


def test_wrong_arguments_are_refused():
    with pytest.raises(ValueError, match="positions"):
        sim.simulate_process(np.zeros((1, 3)), STOCK, MILL, PAPER_LAW, SPEED)
    with pytest.raises(ValueError, match="axes"):
        axes = np.tile([1.0, 0.0, 0.5], (STEPS, 1))
        sim.simulate_process(straight(6e-3), STOCK, MILL, PAPER_LAW, SPEED, axes)


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("name", ["law", "bottom_law"])
@pytest.mark.parametrize("has_exponents", [False, True], ids=["linear", "kienzle"])
def test_a_law_for_another_number_of_teeth_is_refused(has_exponents, name, count):
    plan = pr.choose_engagement(STOCK, MILL, axial_depth=1.6e-3)

    def build(values):
        law = LinearEdgeLaw(1e9, 1e9, 1e9, K_re=values)
        if has_exponents:
            law = KienzleLaw(1e9, 1e9, 1e9, 0.2, values, 0.2)
        laws = {"law": PAPER_LAW, "bottom_law": PAPER_LAW} | {name: law}
        law, bottom = laws.values()
        return pr.Process(STOCK, MILL, law, SPEED, plan, bottom_law=bottom)

    with pytest.raises(ValueError, match=f"`{name}` .* 2 teeth, but has {count}"):
        build(jnp.full(count, 0.3))
    build(jnp.full(2, 0.3))
    build(0.3)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["flat", "ball", "tilted", "point_cloud"])
def test_everything_runs_in_single_precision(case):
    positions = np.stack([np.linspace(-2e-3, 4e-3, 30), np.zeros(30), np.zeros(30)], 1)
    single = lambda x: (
        jnp.asarray(x, jnp.float32) if np.asarray(x).dtype.kind == "f" else x
    )
    low = lambda tree: jax.tree.map(single, tree)
    stock = low(wp.box((0.0, -3e-3, -5e-4), (6e-3, 3e-3, 5e-4), 2.5e-4))
    make = ct.ball_end_mill if case == "ball" else ct.flat_end_mill
    axes = np.tile([0.0, 0.1, 0.995], (30, 1)) if case == "tilted" else None
    mill, law = low(make(5e-3, 2)), low(PAPER_LAW)

    @jax.jit
    def run(positions):
        return sim.simulate_process(
            positions,
            stock,
            mill,
            law,
            spindle_speed=800.0,
            axes=axes,
            axial_depth=1e-3,
            chip="point_cloud" if case == "point_cloud" else "near_far",
        )

    solution = run(positions.astype(np.float32))
    assert solution.force.dtype == jnp.float32
    assert np.all(np.isfinite(solution.force)) and np.any(solution.force != 0)
