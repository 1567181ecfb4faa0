"""Objectives: the tolerance band, weighted rows, and the machined surface."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.spatial
from correction.spring_mass import rounded_square, soft_arm, square_problem
from slides_job import write_slides_job

import diffmill as dm
from diffmill import LineWeight
from diffmill.correction import (
    FinishedSurface,
    GaussNewton,
    GivenCommand,
    Motion,
    PathObjective,
    Problem,
    SurfaceBounds,
    SurfaceObjective,
    row_weights,
)
from diffmill.cutter import flat_end_mill
from diffmill.optimise import LevenbergMarquardt
from diffmill.workpiece import Pose, RemovalWindow, SurfaceError, box

TIME_STEP = 3.75e-3
RADIUS = 5e-3


def straight_problem(deviation):
    path = np.zeros((len(deviation), 3))
    path[:, 0] = 1e-4 * np.arange(len(path))
    problem = Problem(lambda c: c, path, path, np.ones(len(path)), TIME_STEP)
    return problem, Motion(jnp.asarray(path + deviation), jnp.zeros_like(path))


def test_the_band_is_free_and_quadratic_outside():
    across = np.array([0.0, 5e-6, 9.9e-6, 10e-6, 12e-6, -30e-6])
    problem, motion = straight_problem(across[:, None] * np.array([[0.0, 1.0, 0.0]]))
    errors = PathObjective(10e-6).errors(problem, motion, 0.0)
    found = np.sqrt(6) * np.asarray(errors).reshape(-1, 3)[:, 1]
    np.testing.assert_allclose(found, [0, 0, 0, 0, 2e-6, -20e-6], atol=1e-18)

    def cost(y):
        tip = motion.actual.at[3, 1].set(y)
        return jnp.sum(PathObjective(1e-5).errors(problem, Motion(tip, tip), 0.0) ** 2)

    slopes = [float(jax.grad(cost)(jnp.asarray(y))) for y in (0.0, 1e-5, 1.01e-5)]
    others = 2 * 1e-7 / 6
    np.testing.assert_allclose(slopes, [0.0, 0.0, others], atol=1e-15)


def test_the_model_of_a_step_lies_above_the_cost_and_touches_it():
    rng = np.random.default_rng(1)
    problem, motion = straight_problem(1.5e-5 * rng.normal(size=(40, 3)) * [0, 1, 1])
    objective, step = PathObjective(10e-6), jnp.asarray([[0.0, 1.0, 1.0]])
    moved = lambda d: Motion(motion.actual + step * d, motion.force)
    at = lambda one, d: one.errors(problem, moved(d), 0.0)
    cost = lambda d: jnp.sum(at(objective, d) ** 2)
    zero = jnp.zeros_like(motion.actual)
    model = objective.for_step(problem, motion, 0.0)
    slopes = jax.jacfwd(lambda d: at(model, d))(zero)
    error = at(model, zero)
    np.testing.assert_allclose(error, at(objective, zero), atol=1e-18)
    gradient = 2 * jnp.tensordot(error, slopes, 1)
    np.testing.assert_allclose(gradient, jax.grad(cost)(zero), atol=1e-18)
    for size in (1e-6, 1e-5, 1e-4):
        d = jnp.asarray(size * rng.normal(size=zero.shape))
        foreseen = jnp.sum((error + jnp.tensordot(slopes, d, 2)) ** 2)
        assert float(cost(d)) <= float(foreseen) * (1 + 1e-12)


class OwnSlopes(PathObjective):
    """Steps with the slopes of the cost itself."""

    def for_step(self, problem, motion, lag_weight):
        return self


def test_two_steps_come_near_a_band_that_can_be_kept():
    problem = square_problem(TIME_STEP)
    cuts = problem.is_cutting > 0
    largest = lambda contour: np.linalg.norm(contour[cuts], axis=1).max()
    before = problem.contour(problem.run(problem.nominal))
    assert largest(np.asarray(before)) > 600e-6
    band = 150e-6
    solver = LevenbergMarquardt(max_steps=2, damping=1e-4, cost_rtol=1e-2)
    left = {
        kind: largest(
            GaussNewton(30e-3, objective=kind(band), solver=solver)(problem).contour
        )
        for kind in (PathObjective, OwnSlopes)
    }
    assert 0.9 * band < left[PathObjective] < 1.2 * band
    assert left[OwnSlopes] > 2 * left[PathObjective]


def test_no_band_keeps_the_derivative_at_zero():
    problem, motion = straight_problem(np.zeros((5, 3)))
    push = lambda y: PathObjective().errors(
        problem, Motion(motion.actual.at[2, 1].set(y), motion.force), 0.0
    )
    slope = jax.jacfwd(push)(jnp.asarray(0.0))
    assert float(jnp.sum(slope**2)) == pytest.approx(1 / 5)


def test_weights_by_line_and_by_what_finishes():
    is_cutting = np.array([False, True, True, True, True, True])
    line = np.array([1, 2, 2, 3, 4, 4], np.int32)
    weights = row_weights(
        is_cutting, line, sections=[LineWeight(1, 3, 0.5), LineWeight(3, 3, 2.0)]
    )
    np.testing.assert_array_equal(weights, [0, 0.5, 0.5, 2, 1, 1])
    with pytest.raises(ValueError, match="lines 2 to 4"):
        row_weights(is_cutting, line, sections=[LineWeight(0, 9, 0.0)])


def test_rows_that_pass_over_the_surface_count_a_little():
    """Else the command may swing into what has been cut while nothing counts."""
    is_cutting = np.array([False, True, True, False, False])
    touching = np.array([False, True, True, True, False])
    line = np.array([1, 1, 2, 3, 3], np.int32)
    weights = row_weights(is_cutting, line, is_touching=touching)
    np.testing.assert_array_equal(weights, [0, 1, 1, 0.1, 0])
    halves = row_weights(
        is_cutting, line, sections=[LineWeight(3, 3, 0.5)], is_touching=touching
    )
    np.testing.assert_array_equal(halves, [0, 1, 1, 0.05, 0])
    with pytest.raises(ValueError, match="lines 1 to 2"):
        row_weights(
            is_cutting, line, sections=[LineWeight(1, 2, 0.0)], is_touching=touching
        )


def test_what_weighs_nothing_is_left_alone():
    """Half the path without weight: the other half gets the effort."""
    _, path, is_cutting = rounded_square(TIME_STEP)
    half = np.arange(len(path)) < len(path) // 2
    problem = Problem(
        soft_arm(TIME_STEP), path, path, is_cutting * half * 1.0, TIME_STEP
    )
    found = GaussNewton(30e-3)(problem)
    error = np.linalg.norm(found.contour, axis=1)
    late = is_cutting & ~half
    rms = lambda rows: np.sqrt(np.mean(error[rows] ** 2))
    before = np.linalg.norm(GivenCommand()(problem).contour, axis=1)
    assert rms(is_cutting & half) < 0.05 * np.sqrt(np.mean(before[half] ** 2))
    assert rms(late) > 10 * rms(is_cutting & half)


@pytest.fixture(scope="module")
def cutter():
    return flat_end_mill(diameter=2 * RADIUS, teeth=2, helix_angle=0.0)


def cutting(stock, cutter):
    """Return a function that cuts a block along tips."""
    window = RemovalWindow.upright(stock, cutter, 2e-3, 1e-3)

    @jax.jit
    def along(tips):
        def step(stock, x):
            tip, index = x
            poses = Pose(tip[None])
            done = window.remove_poses(
                stock, cutter, poses, index[None], jnp.ones(1, bool)
            )
            return done.stock, None

        rows = jnp.arange(tips.shape[0], dtype=jnp.int32)
        return jax.lax.scan(step, stock, (tips, rows))[0]

    return along


@pytest.fixture(scope="module")
def cut(cutter):
    """Return a function that cuts a block along tips."""
    return cutting(box([0.0, 0.0, -3e-3], [15e-3, 12e-3, 0.0], 0.5e-3), cutter)


def two_passes():
    """A pass along the edge of the block, and a second one 1 mm further in."""
    x = np.arange(-6e-3, 21e-3, 0.2e-3)
    flat = lambda x, y: np.stack([x, y + 0 * x, -1e-3 + 0 * x], axis=1)
    return np.concatenate([flat(x, -1e-3), flat(x[::-1], 0.0)])


def wavy(path):
    deviation = np.zeros_like(path)
    deviation[:, 1] = 60e-6 * np.sin(path[:, 0] / 2e-3)
    # Else both passes would come equally deep wherever they cover the same place.
    tilt = 5e-6 * np.linspace(0.0, 1.0, len(path))
    deviation[:, 2] = 40e-6 * np.cos(path[:, 0] / 1.5e-3) - 10e-6 + tilt
    return path + deviation


def test_surface_error_is_that_of_the_machined_stock(cut):
    path = two_passes()
    actual = wavy(path)
    ideal, machined = cut(jnp.asarray(path)), cut(jnp.asarray(actual))
    surface = FinishedSurface.from_cut(ideal, path, RADIUS)
    error = np.asarray(surface.errors(actual))
    wanted = SurfaceError.of_stock(machined, ideal)

    for is_floor, apart in ((False, 0.05e-6), (True, 1e-12)):
        rows = wanted.is_cut & (wanted.is_floor == is_floor)
        tree = scipy.spatial.KDTree(wanted.points[rows])
        mine = surface.is_wall != is_floor
        nearest = tree.query(surface.points[mine])[1]
        # Away from the edges, where the mesh of the ideal is exact.
        inside = np.abs(surface.points[mine, 0] - 7.5e-3) < 6.5e-3
        truth = wanted.error[rows][nearest][inside]
        assert len(truth) > 20 and np.sqrt(np.mean(truth**2)) > 2e-5
        np.testing.assert_allclose(error[mine][inside], truth, atol=apart)


def test_a_floor_of_an_earlier_job_is_surface_where_the_tool_passes():
    """Else a bound of the gouge does not see it, nor the command that cuts into it."""
    stock = box([0.0, 0.0, -3e-3], [40e-3, 12e-3, -1e-3], 0.5e-3)
    path = np.linspace([5e-3, 6e-3, -1e-3], [20e-3, 6e-3, -1e-3], 60)
    path[40:, 2] = 2e-3
    surface = FinishedSurface.from_cut(stock, path, RADIUS)
    assert not surface.is_wall.any() and surface.points[:, 0].max() < 20e-3
    np.testing.assert_array_equal(surface.touching_rows(path), np.arange(60) < 40)
    deeper = path - np.array([0.0, 0.0, 5e-5])
    np.testing.assert_allclose(surface.errors(deeper), -5e-5, atol=1e-12)
    with pytest.raises(ValueError, match="cut by a pose"):
        FinishedSurface.from_cut(stock, path + np.array([0, 0, 3e-3]), RADIUS)


def test_only_the_second_pass_leaves_the_wall(cut):
    path = two_passes()
    ideal = cut(jnp.asarray(path))
    surface = FinishedSurface.from_cut(ideal, path, RADIUS)
    np.testing.assert_allclose(np.asarray(surface.errors(path)), 0.0, atol=1e-12)
    first = path.copy()
    first[: len(path) // 2, 1] -= 1e-4
    wall = lambda path: np.asarray(surface.errors(path))[surface.is_wall]
    assert np.abs(wall(first)).max() < 1e-9
    second = path.copy()
    second[len(path) // 2 :, 1] += 1e-4
    assert wall(second).mean() == pytest.approx(-1e-4, rel=1e-3)
    assert wall(second).min() == pytest.approx(-1e-4, rel=1e-3)


def test_a_tool_behind_a_rib_does_not_cut_its_front(cut):
    path = two_passes()
    path[len(path) // 2 :, 1] = 13e-3
    surface = FinishedSurface.from_cut(cut(jnp.asarray(path)), path, RADIUS)
    normals = surface.normals[surface.is_wall]
    assert normals[:, 1].min() < -0.99 and normals[:, 1].max() > 0.99
    np.testing.assert_allclose(np.asarray(surface.errors(path)), 0.0, atol=1e-12)


@pytest.mark.parametrize("y", [1.0e-3, 1.1e-3, 1.2e-3])
def test_a_deeper_step_beside_a_floor_does_not_gouge_it(cut, y):
    """However near to a ray of the floor the wall of the step stands."""
    path = two_passes()
    half = len(path) // 2
    path[:half, 1:] = 6e-3, -0.3e-3
    path[half:, 1:] = y, -1.9e-3
    surface = FinishedSurface.from_cut(cut(jnp.asarray(path)), path, RADIUS)
    floors = surface.points[~surface.is_wall, 2]
    assert set(np.round(floors, 9)) == {-0.3e-3, -1.9e-3}
    np.testing.assert_allclose(np.asarray(surface.errors(path)), 0.0, atol=1e-9)


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [2, 3, 0, 1]])
def test_a_tool_behind_a_rib_finishes_no_layer_of_its_front(cutter, order):
    """A rib of 3 mm, 0.3 mm left on either side for the finishing pass."""
    stock = box([0.0, 0.0, -3e-3], [15e-3, 13e-3, 0.0], 0.5e-3)
    passes = []
    for y in (-0.3e-3, 0.0, 13.3e-3, 13e-3):
        passes.append(np.split(two_passes(), 2)[0])
        passes[-1][:, 1] = y
    path = np.concatenate([passes[place] for place in order])
    ideal = cutting(stock, cutter)(jnp.asarray(path))
    surface = FinishedSurface.from_cut(ideal, path, RADIUS)
    layers = SurfaceBounds.layer_thickness(surface, stock, path)[surface.is_wall]
    normals = surface.normals[surface.is_wall]
    assert normals[:, 1].min() < -0.99 and normals[:, 1].max() > 0.99
    np.testing.assert_allclose(layers, 0.3e-3, rtol=1e-4)


def test_a_pass_that_is_cut_again_does_not_finish(cut):
    """The first pass leaves the floor near the edge, all else of it is cut again."""
    path = two_passes()
    path[: len(path) // 2, 2] += 0.3e-3
    ideal = cut(jnp.asarray(path))
    cuts = (path[:, 0] > 0) & (path[:, 0] < 15e-3)
    line = np.ones(len(path), np.int32)
    weights = row_weights(cuts, line, finished=ideal, spread=3)
    np.testing.assert_array_equal(weights > 0, cuts & (np.arange(len(path)) >= 135))


def test_all_poses_over_a_floor_are_seen(cut):
    """Two hundred poses cover each place; the last of them digs."""
    x = np.arange(0.0, 15e-3, 5e-5)
    path = np.stack([x, 6e-3 + 0 * x, -1e-3 + 0 * x], axis=1)
    surface = FinishedSurface.from_cut(cut(jnp.asarray(path)), path, RADIUS)
    floor = ~surface.is_wall
    off = np.abs(surface.points - np.array([[10e-3, 6e-3, 0.0]]))
    under = floor & np.all(off[:, :2] < 1e-3, axis=1)
    assert under.any()
    actual = path.copy()
    actual[-40:, 2] -= 50e-6
    np.testing.assert_allclose(np.asarray(surface.errors(actual))[under], -50e-6)


def test_rows_that_could_spoil_a_surface_are_those_near_it(cut):
    """A pass that cuts, the same in the air, and back again over what was cut."""
    path = two_passes()
    half = len(path) // 2
    high = path[:half] + np.array([[0.0, 0.0, 0.3e-3]])
    path = np.concatenate([path[:half], high[::-1], path[:half]])
    surface = FinishedSurface.from_cut(cut(jnp.asarray(path)), path, RADIUS)
    found = surface.touching_rows(path)
    over = (path[:, 0] > -4e-3) & (path[:, 0] < 19e-3)
    low = path[:, 2] < -0.9e-3
    np.testing.assert_array_equal(found[over & low], True)
    # Its side is as near to the wall as that of the pass below.
    floors = eqx.tree_at(
        lambda s: (s.points, s.normals, s.is_wall, s.poses),
        surface,
        replace_fn=lambda x: x[~surface.is_wall],
    )
    assert not np.any(floors.touching_rows(path)[~low])


def test_lines_that_do_not_count_leave_a_surface_that_does_not(cut):
    path = two_passes()
    surface = FinishedSurface.from_cut(cut(jnp.asarray(path)), path, RADIUS)
    is_second = np.arange(len(path)) >= len(path) // 2
    shares = surface.point_shares(path, is_second * 0.5)
    np.testing.assert_array_equal(shares[surface.is_wall], 0.5)
    # Only the first pass reaches the strip at the edge.
    edge = ~surface.is_wall & (surface.points[:, 1] < 0.0)
    none = surface.point_shares(path, ~is_second * 1.0)
    np.testing.assert_array_equal(none[surface.is_wall], 0.0)
    assert not edge.any() or np.all(none[edge] == 1.0)
    # What counts half as much counts like everything, if everything does.
    problem = Problem(lambda c: c, path, path, np.ones(len(path)), TIME_STEP)
    motion = Motion(jnp.asarray(wavy(path)), jnp.zeros(path.shape))
    errors = lambda shares: np.asarray(
        SurfaceObjective(surface, shares=shares).errors(problem, motion, 0.0)
    )
    half = np.full(len(surface.points), 0.5)
    np.testing.assert_allclose(errors(half), errors(None))
    walls = errors(surface.is_wall * 1.0)[: len(surface.points)]
    np.testing.assert_array_equal(walls[~surface.is_wall], 0.0)
    np.testing.assert_allclose(
        walls[surface.is_wall], errors(None)[: len(surface.points)][surface.is_wall]
    )


def test_surface_derivative_agrees_with_differences(cut):
    path = two_passes()
    surface = FinishedSurface.from_cut(cut(jnp.asarray(path)), path, RADIUS)
    actual, push = (
        jnp.asarray(wavy(path)),
        np.random.default_rng(1).normal(size=path.shape),
    )
    exact = jax.jvp(surface.errors, (actual,), (jnp.asarray(push),))[1]
    step = 1e-9
    ahead = surface.errors(actual + step * push)
    behind = surface.errors(actual - step * push)
    error = np.abs(np.asarray((ahead - behind) / (2 * step) - exact))
    # A few points change the pose that decides.
    assert np.quantile(error, 0.97) < 1e-5


def test_slopes_of_depths_agree_with_derivatives(cut):
    path = two_passes()
    surface = FinishedSurface.from_cut(cut(jnp.asarray(path)), path, RADIUS)
    actual = wavy(path)
    slopes = surface.host_slopes(actual)
    for axis in range(3):
        push = np.zeros_like(actual)
        push[:, axis] = 1.0
        exact = jax.jvp(surface.depths, (jnp.asarray(actual),), (jnp.asarray(push),))[1]
        np.testing.assert_allclose(slopes[axis], exact, atol=1e-12)


def test_the_model_of_a_step_is_that_of_gauss_and_newton_for_a_pose_a_point(cut):
    path = two_passes()
    surface = FinishedSurface.from_cut(cut(jnp.asarray(path)), path, RADIUS)
    actual = wavy(path)
    best = np.argmin(surface.host_depths(actual), axis=1)[:, None]
    alone = np.take_along_axis(np.asarray(surface.poses), best, axis=1)
    surface = eqx.tree_at(lambda s: s.poses, surface, alone)
    problem = Problem(lambda c: c, path, path, np.ones(len(path)), TIME_STEP)
    motion = Motion(jnp.asarray(actual), jnp.zeros(path.shape))

    def normal_equations(objective):
        errors = lambda tips: objective.errors(problem, Motion(tips, motion.force), 0.1)
        J = jax.jacfwd(errors)(motion.actual).reshape(-1, path.size)
        return J.T @ errors(motion.actual), J.T @ J

    for tolerance in (0.0, 1e-5):
        objective = SurfaceObjective(surface, tolerance=tolerance)
        wanted = normal_equations(objective)[0]
        found = normal_equations(objective.for_step(problem, motion, 0.1))
        np.testing.assert_allclose(found[0], wanted, atol=1e-6 * np.abs(wanted).max())
        whole = normal_equations(SurfaceObjective(surface))[1]
        np.testing.assert_allclose(found[1], whole, atol=1e-6 * np.abs(whole).max())


class DeepestMoves(SurfaceObjective):
    """Steps that know the deepest pose of a point alone."""

    def for_step(self, problem, motion, lag_weight):
        return self


def test_poses_about_as_deep_come_out_together():
    """A floor of a wavy tool, too deep by more than the waves: one step lifts it."""
    path = np.linspace([5e-3, 6e-3, -1e-3], [35e-3, 6e-3, -1e-3], 300)
    stock = box([0.0, 0.0, -3e-3], [40e-3, 12e-3, -1e-3], 0.5e-3)
    surface = FinishedSurface.from_cut(stock, path, RADIUS)
    waves = np.zeros_like(path)
    waves[:, 2] = 4e-6 * np.random.default_rng(2).normal(size=300) - 3e-5
    plant = lambda command: Motion(command + waves, jnp.zeros_like(command))
    problem = Problem(plant, path, path, np.ones(300), TIME_STEP)
    solver = LevenbergMarquardt(max_steps=1, damping=1e-4, attempts=1)

    def left(kind):
        method = GaussNewton(30e-3, objective=kind(surface), solver=solver)
        error = surface.errors(method(problem).motion.actual)
        # Where no pose covers that is held at an end.
        middle = np.abs(surface.points[:, 0] - 20e-3) < 6e-3
        return np.sqrt(np.mean(np.square(error)[middle]))

    before = 30e-6
    assert left(SurfaceObjective) < 0.1 * before and left(DeepestMoves) > 0.9 * before


def test_a_wall_has_the_deviation_of_the_instant_at_which_it_is_cut(cut):
    """Rows that tell of the middle of a period, of a tool that drifts into the wall."""
    path = two_passes()
    ideal, rows = cut(jnp.asarray(path)), np.arange(len(path))
    shares = np.full(len(path), 0.5)
    surface = FinishedSurface.from_cut(ideal, path, RADIUS, shares=shares)
    np.testing.assert_allclose(np.asarray(surface.errors(path)), 0.0, atol=1e-12)
    drift = 1e-6
    actual = path + np.array([[0.0, drift, 0.0]]) * (rows - 0.5)[:, None]
    wall = np.asarray(surface.errors(actual))[surface.is_wall]
    # The fixture cuts with the rows, those of the second pass at last.
    second = rows >= len(path) // 2
    place = surface.points[surface.is_wall, 0]
    last = np.interp(place, path[second][::-1, 0], rows[second][::-1])
    # Places lie between two rows.
    np.testing.assert_allclose(wall, -drift * last, atol=0.3 * drift)
    assert np.mean(wall + drift * last) == pytest.approx(0.0, abs=0.05 * drift)


def test_a_pose_stands_where_it_is_at_the_instant_of_a_point(cut):
    """Also where rows are not a period apart, and the path goes on meanwhile."""
    path = two_passes()
    rows, rng = np.arange(len(path)), np.random.default_rng(3)
    shares = rng.uniform(0.2, 1.0, len(path))
    surface = FinishedSurface.from_cut(cut(jnp.asarray(path)), path, RADIUS)
    made = FinishedSurface.from_cut(
        cut(jnp.asarray(path)), path, RADIUS, shares=shares
    ).instants
    assert surface.instants is None and made is not None
    poses = np.array([[20, 21], [30, 31]])
    at = made.of(np.array([19.7, np.nan]), poses, path, shares)
    # A deviation that grows by the same in every period.
    growth = np.array([1e-6, -2e-6, 3e-6])
    actual = path + growth * (rows - 1 + shares)[:, None]
    moved = actual[poses] + at.late[..., None] * np.gradient(actual, axis=0)[poses]
    moved = moved + at.ahead
    when = np.array([19.7, 20.7])
    wanted = [np.interp(when, rows, path[:, i]) + growth[i] * when for i in range(3)]
    np.testing.assert_allclose(moved[0], np.stack(wanted, axis=1), atol=1e-12)
    np.testing.assert_array_equal(moved[1], actual[poses[1]])


CORNERS = """G21 G90 G94
G0 X5 Y4 Z1
G1 Z-0.8 F1500
G1 X10 F3000
G1 Y8
G1 X5
G0 Z1
M2
"""


@pytest.mark.slow
def test_the_walls_of_a_soft_machine_are_those_of_its_stock_around_corners(tmp_path):
    file = write_slides_job(tmp_path, program=CORNERS)
    text = file.read_text().replace('["8 mm", "8 mm", ', '["18 mm", "15 mm", ')
    file.write_text(text.replace('["0 mm", "0 mm", "-2', '["-4 mm", "-4 mm", "-2'))
    done = dm.simulate(dm.load_job(file))
    truth = SurfaceError.of_stock(done.stock, done.rigid.stock, leaves_out_raw=True)
    rows = truth.is_cut & truth.is_across & ~truth.is_floor
    tree = scipy.spatial.KDTree(truth.points[rows])
    path, actual = np.asarray(done.desired), done.desired + done.surface_deviation

    def apart(shares):
        surface = FinishedSurface.from_cut(
            done.rigid.stock, path, RADIUS, shares=shares
        )
        # Against planes the mesh of the ideal is exact.
        mine = surface.is_wall & (np.abs(surface.normals).max(axis=1) > 0.9999)
        wanted = truth.error[rows][tree.query(surface.points[mine])[1]]
        return np.abs(np.asarray(surface.errors(actual))[mine] - wanted).max()

    assert np.abs(truth.error[rows]).max() > 50e-6
    assert apart(np.asarray(done.wall_share)) < 2e-6 < 0.5 * apart(None)


def test_a_wall_that_ends_below_half_a_spacing_is_no_surface_above(cut):
    """Faced first: the wall ends 0.15 mm above its highest ray."""
    path = two_passes()
    facing = path + np.array([[0.0, 4e-3, 0.4e-3]])
    path = np.concatenate([facing, path])
    surface = FinishedSurface.from_cut(cut(jnp.asarray(path)), path, RADIUS)
    assert surface.is_wall.any()
    np.testing.assert_allclose(np.asarray(surface.errors(path)), 0.0, atol=1e-9)


def test_a_floor_that_is_just_missed_has_a_slope_that_leads_back():
    path = np.linspace([5e-3, 6e-3, -1e-3], [20e-3, 6e-3, -1e-3], 60)
    stock = box([0.0, 0.0, -3e-3], [40e-3, 12e-3, -1e-3], 0.5e-3)
    surface = FinishedSurface.from_cut(stock, path, RADIUS)
    short = path - np.array([[0.6e-3, 0.0, 0.0]])
    error = np.asarray(surface.errors(short))
    assert 0.05e-3 < error.max() < 2e-3
    push = np.tile([1.0, 0.0, 0.0], (60, 1))
    slope = jax.jvp(surface.errors, (jnp.asarray(short),), (jnp.asarray(push),))[1]
    assert float(slope[np.argmax(error)]) < -5


def test_the_top_of_a_wall_and_the_rim_of_a_floor_are_seen(cut):
    """A pass above the bottom that digs into the wall, and a rim that dips."""
    path = two_passes()
    half = len(path) // 2
    high = path[half:] + np.array([[0.0, 0.0, 0.4e-3]])
    path = np.concatenate([path[:half], high, path[half:]])
    surface = FinishedSurface.from_cut(cut(jnp.asarray(path)), path, RADIUS)
    np.testing.assert_allclose(np.asarray(surface.errors(path)), 0.0, atol=1e-12)
    actual = path.copy()
    actual[half : half + len(high), 1] += 60e-6
    walls = np.asarray(surface.errors(actual))[surface.is_wall]
    is_top = surface.points[surface.is_wall, 2] > -0.6e-3
    assert is_top.any() and not is_top.all()
    np.testing.assert_allclose(walls[is_top], -60e-6, atol=1e-7)
    np.testing.assert_allclose(walls[~is_top], 0.0, atol=1e-12)
    # Before it enters: a tool whose rim alone is over the stock.
    actual = path.copy()
    before = (path[:, 0] > -5e-3) & (path[:, 0] < -4.6e-3)
    actual[before, 2] -= 50e-6
    assert float(surface.errors(actual).min()) == pytest.approx(-50e-6)


def test_the_surface_comes_out_where_the_tip_does_not(cut):
    """A plant that is pushed off, its first pass cut again by the second."""
    path = two_passes()
    surface = FinishedSurface.from_cut(cut(jnp.asarray(path)), path, RADIUS)
    push = jnp.asarray(wavy(path) - path)

    def plant(command):
        return Motion(command + push, jnp.zeros_like(command))

    over = (path[:, 0] > -5e-3) & (path[:, 0] < 20e-3)
    problem = Problem(plant, path, path, over.astype(float), TIME_STEP)
    method = GaussNewton(15e-3, objective=SurfaceObjective(surface), smoothness=1e-4)

    def p95(method):
        error = np.abs(surface.errors(method(problem).motion.actual))
        rows = (error[surface.is_wall], error[~surface.is_wall])
        return [np.percentile(kind, 95) for kind in rows]

    before, after = p95(GivenCommand()), p95(method)
    assert after[0] < 0.05 * before[0] and after[1] < 0.2 * before[1]
    only_wall = eqx.tree_at(lambda m: m.objective.floor_weight, method, 0.0)
    assert p95(only_wall)[0] < 0.05 * before[0]
