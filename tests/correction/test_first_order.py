"""Adam on the soft arm: slower than Gauss-Newton, but it gets there."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from correction.spring_mass import square_problem
from scipy import sparse

from diffmill.correction import (
    Adam,
    GivenCommand,
    LinearLimits,
    Motion,
    Problem,
    SplineOffsets,
    project,
)

TIME_STEP = 3.75e-3


@pytest.fixture(scope="module")
def problem():
    return square_problem(TIME_STEP)


@pytest.mark.slow
def test_adam_makes_the_error_small_within_the_bound(problem):
    told = []
    before = GivenCommand()(problem)
    found = Adam(steps=60)(problem, on_progress=lambda m, e: told.append(e))
    assert found.measures.rms < 0.3 * before.measures.rms
    assert (found.forward_runs, found.linearisations) == (1, 60)
    assert told == sorted(told, reverse=True)
    tight = eqx.tree_at(lambda p: p.max_offset, problem, np.asarray(5e-5))
    held = Adam(steps=30)(tight)
    assert held.command_statistics.max_offset <= 5e-5 * (1 + 1e-12)
    # From a good start it does not leave the best behind.
    again = Adam(steps=5)(problem, start=np.asarray(found.command))
    assert again.measures.rms <= found.measures.rms * 1.02


def test_adam_keeps_limits_all_the_way():
    """On a plant that follows its command, but for what pushes it."""
    path = np.linspace(0, 1e-2, 60)[:, None] * np.array([[1.0, 0.0, 0.0]])
    push = np.sin(np.linspace(0, 3, 60))[:, None] * np.array([[0.0, 1e-4, 0.0]])
    seen = []

    def plant(command):
        jax.debug.callback(lambda tips: seen.append(np.asarray(tips)), command)
        return Motion(command + jnp.asarray(push), jnp.zeros_like(command))

    problem = Problem(plant, path, path, np.ones(60), TIME_STEP, max_offset=3e-4)
    spline = SplineOffsets(60, TIME_STEP, 30e-3)
    rows = np.asarray(spline.offsets(jnp.eye(spline.coefficient_count)))
    # As a joint's range would: no more than 40 um to the right.
    most = np.full((60, 3), 1.0)
    limit = LinearLimits.by_axis(
        matrix=sparse.csr_array(rows),
        lower=np.where([[0, 1, 0]], -4e-5, -most),
        upper=most,
    )
    free, held = (
        Adam(steps=40, limits=some)(problem, on_progress=lambda *_: None)
        for some in ((), (limit,))
    )
    before = GivenCommand()(problem).measures.rms
    assert free.command[:, 1].min() < -8e-5 and free.measures.rms < 0.3 * before
    assert held.command[:, 1].min() >= -4e-5 * (1 + 1e-9)
    # Here the command nearest to what would take the push back is the best.
    nearest = rows @ project(spline, -push, 3e-4, limits=(limit,))
    best = np.sqrt(np.mean((push + nearest)[:, 1] ** 2))
    assert held.measures.rms < 1.1 * best < 0.8 * before
    # No command that was tried left the limit either.
    jax.effects_barrier()
    tried = np.stack(seen[-held.forward_runs :])
    assert tried[:, :, 1].min() >= -4e-5 * (1 + 1e-9)


def test_adam_goes_on_as_if_it_had_not_been_interrupted():
    """On a plant that follows its command, but for what pushes it."""
    path = np.linspace(0, 1e-2, 60)[:, None] * np.array([[1.0, 0.0, 0.0]])
    push = np.sin(np.linspace(0, 3, 60))[:, None] * np.array([[0.0, 1e-4, 2e-5]])

    def plant(command):
        return Motion(command + jnp.asarray(push), jnp.zeros_like(command))

    problem = Problem(plant, path, path, np.ones(60), TIME_STEP)
    method, kept = Adam(steps=8), []
    found = method(problem, on_checkpoint=kept.append)
    assert len(kept) == 8
    assert found.measures.rms < 0.9 * GivenCommand()(problem).measures.rms
    for arrays in (kept[0], kept[4], kept[-1]):
        assert all(isinstance(value, np.ndarray) for value in arrays.values())
        again = method(problem, resume=arrays)
        np.testing.assert_array_equal(again.command, found.command)
        assert again.forward_runs == found.forward_runs
