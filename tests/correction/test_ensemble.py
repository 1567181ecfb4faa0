"""Correction for a plant that is known to 20 % only, judged on draws it never saw."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from correction.spring_mass import SpringMass, rounded_square, soft_arm
from slides_job import write_slides_job

import diffmill as dm
from diffmill.correction import DelayedPlant, Ensemble, GaussNewton, Problem, delayed
from diffmill.optimise import LevenbergMarquardt

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
    return Ensemble.draw_scales(NAMES, count=count, seed=seed, **sizes)


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
    once = LevenbergMarquardt(max_steps=1, damping=1e-6)
    members = Ensemble(Uncertain(arm), np.zeros((2, 8)))
    found = GaussNewton(30e-3, ensemble=members, solver=once)(problem)
    alone = GaussNewton(30e-3, solver=once)(problem)
    assert found.measures.rms == pytest.approx(alone.measures.rms, rel=1e-3)


@pytest.fixture(scope="module")
def judged(arm, problem):
    """Return a function that gives the errors of a command for draws of the arm."""
    plant, cutting = Uncertain(arm), np.asarray(problem.is_cutting) > 0

    @jax.jit
    def errors(command, draws):
        one = lambda draw: problem.contour(plant(draw, command))
        return jnp.linalg.norm(jax.lax.map(one, draws), axis=2)

    def judge(found, draws, delay=0.0):
        late = delayed(found.command, delay, TIME_STEP, nominal=problem.nominal)
        return np.asarray(errors(late, jnp.asarray(draws)))[:, cutting]

    return judge


SIZES = {"stiffness": 0.2, "damping": 0.2, "force": 0.2}


@pytest.fixture(scope="module")
def robust(arm, problem):
    members = Ensemble(Uncertain(arm), draws(8, 3, **SIZES))
    return GaussNewton(30e-3, ensemble=members)(problem)


def test_robust_is_better_where_the_model_is_wrong(problem, robust, judged):
    others = draws(50, 7, **SIZES)
    each = judged(robust, others)
    nominal = judged(GaussNewton(30e-3)(problem), others)
    assert np.percentile(each, 95) < 0.7 * np.percentile(nominal, 95)
    assert np.mean(each**2) < 0.5 * np.mean(nominal**2)


def test_what_is_left_over_the_draws_is_told(robust, judged):
    each = np.sqrt(np.mean(judged(robust, draws(8, 3, **SIZES)) ** 2, axis=1))
    assert robust.detail["draws"] == len(each)
    # The lag along the path and rows in the air count a little, too.
    assert 1 <= robust.detail["draw_rms_least"] / each.min() < 1.5
    assert 1 <= robust.detail["draw_rms_largest"] / each.max() < 1.5


def test_delays_cover_their_span_and_leave_the_rest():
    members = draws(5, 3, force=0.1)
    found = DelayedPlant.with_delays(members, largest=10e-3, seed=3)
    np.testing.assert_array_equal(found[:, :-1], members)
    # One in each fifth.
    shares = np.sort(found[:, -1]) / 2e-3
    np.testing.assert_array_equal(np.floor(shares), np.arange(5))
    assert (
        DelayedPlant.with_delays(members, largest=10e-3, seed=4)[0, -1] != found[0, -1]
    )
    np.testing.assert_array_equal(
        DelayedPlant.with_delays(members, largest=0, seed=3)[:, -1], 0
    )
    with pytest.raises(ValueError, match=r"`largest`.* 0"):
        DelayedPlant.with_delays(members, largest=-1e-3, seed=0)


def test_only_the_offset_of_a_member_is_late(arm, problem):
    member = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    nominal = jnp.asarray(problem.nominal)
    offset = 1e-4 * jnp.asarray(np.sin(np.arange(len(nominal)) / 9.0))[:, None]
    plant = Uncertain(arm)
    late = DelayedPlant(plant, problem.nominal, TIME_STEP)
    parameters = jnp.asarray([*member, 2 * TIME_STEP])
    found = late.member(parameters)(nominal + offset).actual
    shifted = jnp.concatenate([jnp.zeros((2, 1)), offset[:-2]])
    wanted = plant(jnp.asarray(member), nominal + shifted).actual
    np.testing.assert_allclose(found, wanted, atol=1e-12)


@pytest.mark.slow
def test_robust_is_better_where_the_offset_comes_late(arm, problem, judged):
    largest = 20e-3
    members = DelayedPlant.with_delays(np.zeros((4, 8)), largest=largest, seed=1)
    late = DelayedPlant(Uncertain(arm), problem.nominal, TIME_STEP)
    robust = GaussNewton(30e-3, ensemble=Ensemble(late, members))(problem)
    nominal = GaussNewton(30e-3)(problem)
    as_it_is = np.zeros((1, 8))
    each = lambda found: np.concatenate(
        [judged(found, as_it_is, delay) for delay in np.linspace(0, largest, 9)]
    )
    rms = lambda errors: np.sqrt(np.mean(errors**2))
    assert rms(each(robust)) < 0.7 * rms(each(nominal))


@pytest.mark.slow
@pytest.mark.parametrize(("steps", "share", "unseen"), [(2, 0.95, 1.0), (6, 0.8, 0.92)])
def test_the_worst_case_is_better_for_the_worst_member(
    arm, problem, robust, judged, steps, share, unseen
):
    members = draws(8, 3, **SIZES)
    # A job takes two steps if it asks for no others; the mean has settled.
    method = GaussNewton(
        30e-3,
        solver=dataclasses.replace(GaussNewton.solver, max_steps=steps),
        ensemble=Ensemble(Uncertain(arm), members),
        is_worst_case=True,
    )
    found = method(problem)
    worst = lambda each: np.sqrt(np.mean(each**2, axis=1)).max()
    assert worst(judged(found, members)) < share * worst(judged(robust, members))
    others = draws(50, 7, **SIZES)
    assert worst(judged(found, others)) < unseen * worst(judged(robust, others))


@pytest.mark.parametrize("delay", [0.0, 4e-3, 10e-3])
def test_a_ramp_comes_late(delay):
    time = TIME_STEP * np.arange(50)
    ramp = np.stack([time, 2 * time], axis=1)
    late = np.maximum(time - delay, 0)
    found = delayed(ramp, delay, TIME_STEP)
    np.testing.assert_allclose(found, np.stack([late, 2 * late], axis=1), atol=1e-15)
    np.testing.assert_array_equal(delayed(ramp, delay, TIME_STEP, nominal=ramp), ramp)


def test_only_the_offset_is_late():
    time = TIME_STEP * np.arange(50)
    nominal = jnp.asarray(time[:, None] ** 2)
    offset = jnp.asarray(np.sin(40 * time)[:, None])
    found = delayed(nominal + offset, 2 * TIME_STEP, TIME_STEP, nominal=nominal)
    np.testing.assert_allclose(found[2:], nominal[2:] + offset[:-2], atol=1e-14)
    np.testing.assert_allclose(found[:3], nominal[:3] + offset[:1], atol=1e-14)


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    return dm.load_job(write_slides_job(tmp_path_factory.mktemp("job")))


def with_correction(job, **changes):
    settings = dataclasses.replace(job.correction, **changes)
    return dataclasses.replace(job, correction=settings)


def test_machines_that_do_not_suit_are_refused(job):
    with pytest.raises(ValueError, match="`machines` must be jobs with the path"):
        dm.correct(job, machines=[])
    mirrored = with_correction(job, method="mirror", acceleration_factor=np.inf)
    with pytest.raises(ValueError, match="`machines` must be None unless"):
        dm.correct(mirrored, machines=[job])


@pytest.mark.slow
def test_a_machine_that_is_the_model_changes_no_correction(job):
    """The model, touched off, as the only machine to be robust against."""
    plain = dm.correct(job)
    found = dm.correct(job, machines=[dm.sim.mismatched(job, job)])
    np.testing.assert_allclose(found.commanded, plain.commanded, atol=2e-6)


@pytest.mark.slow
def test_a_robust_command_is_better_on_the_machines_of_its_ensemble(job):
    sizes = dm.UncertaintySettings(
        friction=2e-5, backlash=2e-5, links=1e-4, registration=1e-6, draws=3, seed=1
    )
    robust = dm.correct(with_correction(job, uncertainty=sizes))
    assert robust.methods["corrected"].detail["draws"] == 3
    machines = [dm.sim.drawn_machine(job, sizes, k) for k in range(3)]
    plain = dm.correct(job)
    left = [
        [dm.simulate(m, commanded=x.commanded).contour.rms for m in machines]
        for x in (robust, plain)
    ]
    assert np.all(np.array(left[0]) < 0.9 * np.array(left[1]))
