"""What is held, not penalised: surface bounds and joints; and the worst case."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffmill.correction import (
    AbstractPiece,
    Ensemble,
    FinishedSurface,
    GaussNewton,
    InfeasibleLimit,
    Mirror,
    Motion,
    Problem,
    SurfaceBounds,
)
from diffmill.optimise import LevenbergMarquardt
from diffmill.workpiece import box

TIME_STEP = 5e-3
RADIUS = 5e-3
ROWS = 161
PATIENT = LevenbergMarquardt(max_steps=12, damping=1e-6, cost_rtol=1e-6)


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


class Pushed(AbstractPiece):
    """Rows that are pushed into the wall and off it, the more the further."""

    path: jax.Array
    push: jax.Array

    def __call__(self, command):
        bend = 1 + 0.3 * jnp.sin((command - self.path) / 1e-4)
        return Motion(command + self.push * bend, jnp.zeros_like(command))

    def run(self, command):
        """Run the rows; nothing is remembered."""
        return self(command), jnp.zeros(())


def pushed(max_offset=1e-3):
    """A pass of such a plant, and its surface."""
    path, surface = straight_wall()
    phase = np.arange(ROWS) / ROWS
    push = np.zeros_like(path)
    push[:, 1] = 1e-4 * np.sin(40 * phase) * np.sin(np.pi * phase) ** 2
    plant = Pushed(jnp.asarray(path), jnp.asarray(push))
    return Problem(plant, path, path, np.ones(ROWS), TIME_STEP, max_offset), surface


def leaving():
    """A program that is rewarded for leaving the wall, and its surface."""
    problem, surface = pushed()
    way = np.sin(np.linspace(0, np.pi, ROWS)[:, None])
    away = problem.desired + np.array([[0.0, 2e-4, 0.0]]) * way
    return dataclasses.replace(problem, desired=away), surface


@pytest.fixture(scope="module")
def held_and_free():
    problem, surface = pushed()
    # Knots this far apart cannot follow the push.
    free = GaussNewton(70e-3, solver=PATIENT)(problem)
    deepest = -float(np.asarray(surface.errors(free.motion.actual)).min())
    bounds = SurfaceBounds.about(surface, gouge=0.6 * deepest)
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
    method = GaussNewton(70e-3, bounds=SurfaceBounds.about(surface, gouge=gouge))
    with pytest.raises(InfeasibleLimit) as refused:
        method(problem)
    text = str(refused.value)
    assert f"`gouge` is {1e6 * gouge:.4g} um and cannot be held" in text
    assert "um too much" in text
    assert "reaches `max_offset` (" in text


def test_the_tool_stays_in_a_thin_layer():
    """A program that is rewarded for leaving the wall may not leave the cut."""
    problem, surface = leaving()
    layers = np.full(len(surface.points), 1e-4)
    # The mirror's step is larger than the layer.
    mirrored = Mirror()(problem)
    assert np.asarray(surface.errors(mirrored.motion.actual)).max() > 1.5e-4
    bounds = SurfaceBounds.about(surface, layers=layers)
    held = GaussNewton(70e-3, bounds=bounds, solver=PATIENT)(problem)
    most = np.asarray(surface.errors(held.motion.actual)).max()
    assert 0.8e-4 < most <= 0.9e-4
    blocked, _ = pushed(max_offset=2e-5)
    thin = SurfaceBounds.about(surface, layers=np.full(len(surface.points), 3e-5))
    with pytest.raises(InfeasibleLimit, match=r"`stay_in_cut` .* um"):
        GaussNewton(70e-3, bounds=thin)(blocked)


def test_layers_reach_to_the_earlier_pass_or_the_raw_surface():
    path, surface = straight_wall()
    earlier = path[::-1] + np.array([[0.0, 3e-4, 0.0]])
    both = np.concatenate([earlier, path])
    moved = eqx.tree_at(lambda s: s.poses, surface, surface.poses + np.int32(ROWS))
    raw = box([0.0, -2e-2, -1e-2], [3.2e-2, -3.8e-3, 4e-3], 5e-4)
    second = SurfaceBounds.layer_thickness(moved, raw, both)
    np.testing.assert_allclose(second, 3e-4, atol=1e-9)
    # Alone, the pass takes all from the raw surface at y = -3.8 mm to its wall.
    np.testing.assert_allclose(
        SurfaceBounds.layer_thickness(surface, raw, path), 1.2e-3, atol=1e-9
    )


@pytest.mark.parametrize(
    "amounts", [[0.0, 0.1, 0.2, 1.0], [*np.linspace(0.0, 0.3, 60), 1.0]]
)
def test_the_worst_member_gets_the_middle_of_all(amounts):
    """Members that are shifted alike but by different amounts: mean and midrange."""
    path, _ = straight_wall()
    hump = np.sin(np.pi * np.arange(ROWS) / (ROWS - 1))[:, None] ** 4
    across = jnp.asarray(hump * np.array([[0.0, 1e-4, 0.0]]))
    amounts = np.array(amounts)[:, None]

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
    worst, rounds = middle({"on_checkpoint": kept.append}, is_worst_case=True)
    assert mean == pytest.approx(np.mean(amounts), rel=0.02)
    assert worst == pytest.approx(0.5, rel=0.01)
    # The rounds of its weights are those of a quadratic program, not of linear systems.
    assert rounds.linearisations <= 2 * once.linearisations
    # An interruption after any step changes nothing, to the bit.
    for memory in kept:
        _, again = middle({"resume": memory}, is_worst_case=True)
        np.testing.assert_array_equal(again.command, rounds.command)
        assert [s.cost for s in again.history] == [s.cost for s in rounds.history]
        assert again.linearisations == rounds.linearisations
        assert again.result == rounds.result
