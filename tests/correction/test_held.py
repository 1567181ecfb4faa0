"""What is held, not penalised: surface bounds and joints; and the worst case."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize

from diffmill import RESULTS
from diffmill.correction import (
    Ensemble,
    FinishedSurface,
    GaussNewton,
    HeldRows,
    InfeasibleLimit,
    LeastSquaresSolution,
    LevenbergMarquardt,
    Mirror,
    Motion,
    Problem,
    layer_thickness,
    least_squares,
    surface_bounds,
    worst_case,
)
from diffmill.correction._method.checkpoint import pack_worst_case, unpack_worst_case
from diffmill.workpiece import box

TIME_STEP = 5e-3
RADIUS = 5e-3
ROWS = 161
PATIENT = LevenbergMarquardt(max_steps=12, max_products=60, cost_rtol=1e-6)


@pytest.mark.parametrize("shift", [0.0, 1.5])
def test_held_rows_are_those_of_a_dense_solver(shift):
    """Once from a start that keeps them, once from one that does not."""
    rng = np.random.default_rng(0)
    A, b = rng.normal(size=(20, 6)) * 0.4, rng.normal(size=20)
    C = rng.normal(size=(5, 6))

    def residual(x, args):
        A, b, C, shift = args
        r = jnp.sin(A @ x) + 0.1 * (A @ x) - b
        return jnp.concatenate([r, C @ x + 0.2 * jnp.sin(C @ x) - shift])

    args = tuple(map(jnp.asarray, (A, b, C, shift)))
    rows = jax.jit(lambda x: residual(x, args))
    solver = LevenbergMarquardt(
        max_steps=40, max_products=80, cost_rtol=1e-8, inner_rtol=1e-6
    )
    held = HeldRows(np.full(5, -0.5), np.full(5, 0.5))
    found = least_squares(residual, jnp.zeros(6), args, held=held, solver=solver)
    value = np.asarray(rows(found.x))
    assert np.all(np.abs(value[20:]) <= 0.5)
    np.testing.assert_array_equal(value[20:], found.held)
    assert found.cost == pytest.approx(0.5 * np.sum(value[:20] ** 2))
    # Drawn in as the linear model is: the true optimum lies a little lower.
    drawn = 0.95 * 0.5
    dense = minimize(
        lambda x: 0.5 * np.sum(np.asarray(rows(x))[:20] ** 2),
        np.asarray(found.x),
        constraints=[
            {"type": "ineq", "fun": lambda x: drawn - np.asarray(rows(x))[20:]},
            {"type": "ineq", "fun": lambda x: drawn + np.asarray(rows(x))[20:]},
        ],
        options={"maxiter": 300, "ftol": 1e-12},
    )
    assert found.cost < 1.03 * dense.fun


def test_steps_outside_the_bounds_do_not_count():
    """The way back may be long; what comes after it is what was asked for."""

    def residual(x, args):
        return jnp.concatenate([x - 5.0, 8 + x[:1] + jnp.sin(3 * x[:1]) - 2 * x[1:]])

    held = HeldRows(np.full(1, -0.1), np.full(1, 0.1))
    solver = LevenbergMarquardt(max_steps=2, cost_rtol=1e-9, inner_rtol=1e-6)
    start = jnp.asarray([-3.0, -6.0])
    found = least_squares(residual, start, held=held, solver=solver)
    assert held.is_within(found.held)
    outside = [step.weight > 0 for step in found.history]
    assert outside == sorted(outside, reverse=True)
    assert sum(outside) > 0
    assert len(outside) - sum(outside) == 2


def straight_wall():
    """A pass along +x whose wall lies to its right, with a point at every row."""
    path = np.zeros((ROWS, 3))
    path[:, 0] = 2e-4 * np.arange(ROWS)
    inner = np.arange(40, ROWS - 40)
    points = path[inner] + np.array([[0.0, -RADIUS, 1e-3]])
    poses = (inner[:, None] + np.arange(-3, 4)[None]).astype(np.int32)
    normals = np.tile([0.0, 1.0, 0.0], (len(inner), 1))
    is_wall = np.ones(len(inner), bool)
    return path, FinishedSurface(points, normals, is_wall, poses, RADIUS)


def pushed(max_offset=1e-3):
    """A plant that is pushed into the wall and off it, the more the further it is."""
    path, surface = straight_wall()
    phase = np.arange(ROWS) / ROWS
    push = np.zeros_like(path)
    push[:, 1] = 1e-4 * np.sin(40 * phase) * np.sin(np.pi * phase) ** 2

    def plant(command):
        bend = 1 + 0.3 * jnp.sin((command - path) / 1e-4)
        return Motion(command + push * bend, jnp.zeros_like(command))

    problem = Problem(plant, path, path, np.ones(ROWS), TIME_STEP, max_offset)
    return problem, surface


@pytest.fixture(scope="module")
def held_and_free():
    problem, surface = pushed()
    # Knots this far apart cannot follow the push.
    free = GaussNewton(70e-3, solver=PATIENT)(problem)
    deepest = -float(np.asarray(surface.errors(free.motion.actual)).min())
    bounds = surface_bounds(surface, gouge=0.6 * deepest)
    held = GaussNewton(70e-3, solver=PATIENT, bounds=bounds)(problem)
    return free, held, surface, 0.6 * deepest


def test_the_gouge_limit_is_held_and_costs_accuracy(held_and_free):
    free, held, surface, gouge = held_and_free
    errors = np.asarray(surface.errors(held.motion.actual))
    assert -errors.min() <= gouge
    assert -errors.min() > 0.9 * gouge
    assert free.measures.rms < held.measures.rms < 2 * free.measures.rms


def test_a_gouge_limit_that_cannot_be_held_is_named(held_and_free):
    *_, surface, gouge = held_and_free
    problem, _ = pushed(max_offset=2e-5)
    method = GaussNewton(70e-3, bounds=surface_bounds(surface, gouge=gouge))
    with pytest.raises(InfeasibleLimit) as refused:
        method(problem)
    text = str(refused.value)
    assert f"`gouge` is {1e6 * gouge:.4g} um and cannot be held" in text
    assert "um too much" in text
    assert "stands at `max_offset` (" in text


def test_the_tool_stays_in_a_thin_layer():
    """A program that is rewarded for leaving the wall may not leave the cut."""
    problem, surface = pushed()
    away = problem.desired + np.array([[0.0, 2e-4, 0.0]]) * np.sin(
        np.linspace(0, np.pi, ROWS)[:, None]
    )
    problem = dataclasses.replace(problem, desired=away)
    layers = np.full(len(surface.points), 1e-4)
    # The mirror's step is larger than the layer.
    mirrored = Mirror()(problem)
    assert np.asarray(surface.errors(mirrored.motion.actual)).max() > 1.5e-4
    bounds = surface_bounds(surface, layers=layers)
    held = GaussNewton(70e-3, bounds=bounds, solver=PATIENT)(problem)
    most = np.asarray(surface.errors(held.motion.actual)).max()
    assert 0.8e-4 < most <= 0.9e-4
    blocked, _ = pushed(max_offset=2e-5)
    thin = surface_bounds(surface, layers=np.full(len(surface.points), 3e-5))
    with pytest.raises(InfeasibleLimit, match=r"`stay_in_cut` cannot.*um too much"):
        GaussNewton(70e-3, bounds=thin)(blocked)


def test_layers_reach_to_the_earlier_pass_or_the_raw_surface():
    path, surface = straight_wall()
    earlier = path[::-1] + np.array([[0.0, 3e-4, 0.0]])
    both = np.concatenate([earlier, path])
    moved = eqx.tree_at(lambda s: s.poses, surface, surface.poses + np.int32(ROWS))
    raw = box([0.0, -2e-2, -1e-2], [3.2e-2, -3.8e-3, 4e-3], 5e-4)
    second = layer_thickness(moved, raw, both)
    np.testing.assert_allclose(second, 3e-4, atol=1e-9)
    # Alone, the pass takes all from the raw surface at y = -3.8 mm to its wall.
    np.testing.assert_allclose(layer_thickness(surface, raw, path), 1.2e-3, atol=1e-9)


def test_the_worst_member_gets_the_middle_of_all():
    """Members that are shifted alike but by different amounts: mean and midrange."""
    path, _ = straight_wall()
    hump = np.sin(np.pi * np.arange(ROWS) / (ROWS - 1))[:, None] ** 4
    across = jnp.asarray(hump * np.array([[0.0, 1e-4, 0.0]]))
    amounts = np.array([[0.0], [0.1], [0.2], [1.0]])

    def plant(amount, command):
        return Motion(command + amount[0] * across, jnp.zeros_like(command))

    problem = Problem(
        lambda c: plant(jnp.zeros(1), c), path, path, np.ones(ROWS), TIME_STEP
    )

    def middle(memory=None, **options):
        method = GaussNewton(
            40e-3, smoothness=0.0, ensemble=Ensemble(plant, amounts), **options
        )
        found = method(problem, **(memory or {}))
        offset = np.asarray(found.command)[ROWS // 2, 1]
        return -offset / 1e-4, found

    mean, once = middle()
    kept = []
    worst, rounds = middle({"on_memory": kept.append}, is_worst_case=True)
    assert mean == pytest.approx(np.mean(amounts), rel=0.02)
    assert worst == pytest.approx(0.5, rel=0.05)
    assert rounds.products > once.products
    assert [s.step for s in rounds.history] == list(range(1, len(rounds.history) + 1))
    # An interruption in any round changes nothing, to the bit.
    assert [m.round for m in kept[:1] + kept[-1:]] == [0, 5]
    for memory in (kept[0], kept[len(kept) // 2], kept[-1]):
        memory = unpack_worst_case(pack_worst_case(memory))
        _, again = middle({"resume": memory}, is_worst_case=True)
        np.testing.assert_array_equal(again.command, rounds.command)
        assert [s.cost for s in again.history] == [s.cost for s in rounds.history]
        assert (again.products, again.result) == (rounds.products, rounds.result)


def test_a_round_that_leaves_its_bounds_is_not_the_best():
    """The first one ends outside with a smaller error than all that follow."""

    class Weighted(eqx.Module):
        draws: np.ndarray
        weights: np.ndarray | None = None

    class Args(eqx.Module):
        ensemble: Weighted

    def solve(start, args, *, on_memory, resume):
        x = jnp.full(1, next(points))
        return LeastSquaresSolution(
            x, 0.0, (), RESULTS.successful, np.full(1, next(rows))
        )

    held = HeldRows(np.full(1, -0.1), np.full(1, 0.1))
    errors = lambda x, args: np.full(2, float(x[0]))
    args = Args(Weighted(np.zeros((2, 1))))
    for is_held, best in ((lambda s: True, 1.0), (lambda s: held.is_within(s.held), 2)):
        points, rows = iter([1.0, 3.0, 2.0]), iter([0.2, 0.05, 0.05])
        found = worst_case(solve, errors, jnp.zeros(1), args, rounds=2, is_held=is_held)
        assert float(found.x[0]) == best
