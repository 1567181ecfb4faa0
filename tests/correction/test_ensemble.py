"""Correction for a plant that is known to 20 % only, judged on draws it never saw."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from correction.spring_mass import SpringMass, rounded_square, soft_arm

from diffmill.correction import (
    Ensemble,
    GaussNewton,
    LevenbergMarquardt,
    Problem,
    contour_of,
    draw_scales,
)

TIME_STEP = 3.75e-3
NAMES = ("K x", "K y", "K z", "D x", "D y", "D z", "K_tc", "speed")


class Uncertain(eqx.Module):
    """The soft arm with scaled springs, dampers and cut."""

    arm: SpringMass

    def __call__(self, log_scale, command):
        factor = jnp.exp(log_scale)
        arm = eqx.tree_at(
            lambda a: (a.stiffness, a.damping, a.across, a.along),
            self.arm,
            (
                self.arm.stiffness * factor[:3],
                self.arm.damping * factor[3:6],
                self.arm.across * factor[6],
                self.arm.along * factor[6],
            ),
        )
        return arm(command)


def draws(count, seed, **sizes):
    return draw_scales(NAMES, count=count, seed=seed, **sizes)


def test_draws_are_what_they_say():
    found = draws(4000, 1, stiffness=0.2, damping=0.5)
    factors = np.exp(found)
    assert found.shape == (4000, 8)
    assert np.all(np.abs(factors[:, :3] - 1) <= 0.2)
    np.testing.assert_allclose(factors[:, :3].mean(0), 1.0, atol=0.01)
    np.testing.assert_allclose(factors[:, :3].std(0), 0.2 / np.sqrt(3), rtol=0.05)
    np.testing.assert_allclose(factors[:, 3:6].std(0), 0.5 / np.sqrt(3), rtol=0.05)
    np.testing.assert_array_equal(found[:, 6:], 0.0)
    normal = draws(4000, 1, force=0.3, is_gaussian=True)
    assert normal[:, 6].std() == pytest.approx(0.3, rel=0.05)
    np.testing.assert_array_equal(draws(3, 5, force=0.1), draws(3, 5, force=0.1))
    with pytest.raises(ValueError, match="below 1"):
        draws(3, 5, stiffness=1.0)


@pytest.fixture(scope="module")
def arm():
    return soft_arm(TIME_STEP)


@pytest.fixture(scope="module")
def problem(arm):
    _, path, is_cutting = rounded_square(TIME_STEP)
    return Problem(arm, path, path, is_cutting * 1.0, TIME_STEP)


@pytest.mark.slow
def test_an_ensemble_of_the_nominal_plant_changes_nothing(arm, problem):
    once = LevenbergMarquardt(max_steps=1)
    members = Ensemble(Uncertain(arm), np.zeros((2, 8)))
    found = GaussNewton(30e-3, ensemble=members, solver=once)(problem)
    alone = GaussNewton(30e-3, solver=once)(problem)
    assert found.measures.rms == pytest.approx(alone.measures.rms, rel=1e-3)


def test_robust_is_better_where_the_model_is_wrong(arm, problem):
    sizes = {"stiffness": 0.2, "damping": 0.2, "force": 0.2}
    plant = Uncertain(arm)
    others = draws(50, 7, **sizes)

    @jax.jit
    def errors(command):
        motions = Ensemble(plant, others).motions(command)
        vectors = jax.vmap(lambda motion: contour_of(problem, motion))(motions)
        return jnp.linalg.norm(vectors, axis=2)

    cutting = np.asarray(problem.is_cutting) > 0

    def judged(found):
        each = np.asarray(errors(jnp.asarray(found.command)))[:, cutting]
        return np.percentile(each, 95), np.sqrt(np.mean(each**2))

    robust = GaussNewton(30e-3, ensemble=Ensemble(plant, draws(8, 3, **sizes)))
    nominal = GaussNewton(30e-3)
    p95, rms = judged(robust(problem))
    nominal_p95, nominal_rms = judged(nominal(problem))
    assert p95 < 0.7 * nominal_p95
    assert rms < 0.7 * nominal_rms
