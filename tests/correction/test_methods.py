"""All methods on a soft arm whose cut depends on where the tool really is."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from correction.spring_mass import rounded_square, soft_arm, square_problem

from diffmill import RESULTS, SimulationFailed
from diffmill.correction import (
    GaussNewton,
    GivenCommand,
    IteratedMirror,
    Mirror,
    Motion,
    Problem,
    SplineOffsets,
    project,
    residual,
)
from diffmill.optimise import LevenbergMarquardt

TIME_STEP = 3.75e-3
KNOTS = 30e-3


@pytest.fixture(scope="module")
def problem():
    return square_problem(TIME_STEP)


@pytest.fixture(scope="module")
def uncorrected(problem):
    return GivenCommand()(problem)


@pytest.fixture(scope="module")
def mirrored(problem):
    return IteratedMirror()(problem)


def inverse_drive_of(problem):
    """The inverse drive of the plant's three independent joints."""
    plant, path = problem.plant, np.asarray(problem.desired)
    K, D = np.asarray(plant.stiffness), np.asarray(plant.damping)
    ends = np.pad(path, ((1, 1), (0, 0)), mode="edge")
    acceleration = np.diff(ends, 2, axis=0) / TIME_STEP**2
    means = np.asarray(plant.process_alone(jnp.asarray(path)))
    force = (means + np.append(means[1:], means[-1:], axis=0)) / 2
    torque = np.asarray(plant.mass) * acceleration - force
    # D delta' + K delta = tau, implicitly by the trapezoidal rule.
    delta = torque / K
    for k in range(1, len(path)):
        half = TIME_STEP / 2 * (torque[k - 1] + torque[k] - K * delta[k - 1])
        delta[k] = (D * delta[k - 1] + half) / (D + TIME_STEP / 2 * K)
    return path + delta


@pytest.fixture(scope="module")
def inverted(problem):
    return GivenCommand(inverse_drive_of(problem))(problem)


@pytest.fixture(scope="module")
def optimised(problem, inverted):
    return GaussNewton(KNOTS)(problem, start=inverted.command)


def residual_at(problem, seed=0):
    fit = residual(problem, knot_spacing=KNOTS)
    rng = np.random.default_rng(seed)
    # Offsets of 10 um, in units of the largest that is allowed.
    return fit, jnp.asarray(1e-2 * rng.normal(size=fit.start.shape)), rng


def test_the_inverse_drive_leaves_a_hundredth(uncorrected, inverted):
    assert inverted.measures.rms < 0.01 * uncorrected.measures.rms


def test_a_force_of_the_wrong_sign_is_seen(problem, uncorrected, inverted):
    reversed_cut = eqx.tree_at(
        lambda p: (p.plant.across, p.plant.along), problem, replace_fn=lambda x: -x
    )
    wrong = GivenCommand(inverse_drive_of(reversed_cut))(problem)
    # What the mass asks for is still right, twice the force is not.
    assert wrong.measures.rms > 0.5 * uncorrected.measures.rms
    assert wrong.measures.rms > 20 * inverted.measures.rms


def test_gauss_newton_beats_the_mirror_and_the_projected_inverse_drive(
    problem, uncorrected, mirrored, inverted, optimised
):
    spline = SplineOffsets(len(problem.desired), TIME_STEP, KNOTS)
    offset = np.asarray(inverted.command) - problem.nominal
    projected = spline.offsets(jnp.asarray(project(spline, offset, 1e-3)))
    same_knots = GivenCommand(problem.nominal + np.asarray(projected))(problem)
    best = optimised.measures
    assert best.rms < 0.05 * uncorrected.measures.rms
    assert best.rms < 0.2 * mirrored.measures.rms
    assert best.rms < 0.6 * same_knots.measures.rms
    assert optimised.linearisations == optimised.history[-1].models


def test_gauss_newton_from_zero_comes_as_far(problem, optimised):
    from_zero = GaussNewton(KNOTS)(problem)
    assert from_zero.measures.rms < 1.2 * optimised.measures.rms


@pytest.mark.slow
def test_finer_knots_leave_less(problem, optimised, inverted):
    finer = GaussNewton(KNOTS / 2)(problem, start=inverted.command)
    assert finer.measures.rms < 0.4 * optimised.measures.rms
    assert finer.measures.rms < inverted.measures.rms


@pytest.mark.slow
def test_a_tight_bound_holds_exactly_and_costs_accuracy(problem, optimised):
    bound = 2e-4
    tight = eqx.tree_at(lambda p: p.max_offset, problem, bound)
    found = GaussNewton(KNOTS)(tight)
    assert found.detail["bound_count"] > 0
    assert found.command_statistics.max_offset <= bound * (1 + 1e-12)
    assert found.measures.rms > optimised.measures.rms
    clipped = Mirror()(tight)
    assert clipped.command_statistics.max_offset == pytest.approx(bound, rel=1e-12)


def test_jacobian_products_agree_with_central_differences(problem):
    fit, c, rng = residual_at(problem)
    v = rng.normal(size=c.shape)
    errors = jax.jit(lambda x: fit.residual(x, fit.args))
    exact = jax.jvp(errors, (c,), (jnp.asarray(v),))[1]
    # 10 nm: far below the path's segments, far above rounding.
    step = 1e-8 / float(problem.max_offset)
    ahead, behind = errors(c + step * v), errors(c - step * v)
    difference = np.asarray(ahead - behind) / (2 * step)
    # Where the nearest segment changes between the two, the difference is no limit.
    error = np.abs(difference - np.asarray(exact)) / np.abs(exact).max()
    assert np.quantile(error, 0.99) < 1e-5


def test_forward_and_reverse_products_are_adjoint(problem):
    fit, c, rng = residual_at(problem, 1)
    errors = jax.jit(lambda x: fit.residual(x, fit.args))
    r, pull = jax.vjp(errors, c)
    v = jnp.asarray(rng.normal(size=c.shape))
    w = jnp.asarray(rng.normal(size=r.shape))
    J_v = jax.jvp(errors, (c,), (v,))[1]
    assert float(jnp.vdot(J_v, w)) == pytest.approx(
        float(jnp.vdot(v, pull(w)[0])), rel=1e-10
    )


def test_residual_is_the_error_it_claims(problem, uncorrected):
    fit = residual(problem, knot_spacing=KNOTS, lag_weight=0.0)
    r = fit.residual(fit.start, fit.args)
    error = np.linalg.norm(uncorrected.contour, axis=1)
    weights = np.asarray(problem.is_cutting)
    # In the air an error counts a hundredth.
    air = 1e-4 * np.sum(error[weights == 0] ** 2) / np.sum(weights)
    expected = np.sqrt(uncorrected.measures.rms**2 + air)
    rms = 1e-4 * float(jnp.sqrt(jnp.sum(r**2)))
    assert rms == pytest.approx(expected, rel=1e-12)


def test_iterated_mirror_keeps_the_best_and_counts_its_runs(
    problem, uncorrected, mirrored
):
    assert mirrored.measures.rms < uncorrected.measures.rms
    assert mirrored.forward_runs < mirrored.detail["runs_of_full_grid"]
    alone = IteratedMirror(
        cutoffs=(mirrored.detail["cutoff"],),
        relaxations=(mirrored.detail["relaxation"],),
    )(problem)
    assert alone.measures.rms == mirrored.measures.rms


def test_a_sampled_mirror_takes_the_branch_of_its_sample(problem, mirrored):
    """With all rows as its sample it is the whole grid; with half, what suits them."""
    whole = IteratedMirror(sample=problem)(problem)
    assert whole.measures.rms == mirrored.measures.rms
    assert whole.forward_runs > mirrored.forward_runs
    half = slice(len(problem.desired) // 2)
    sample = dataclasses.replace(
        problem,
        nominal=problem.nominal[half],
        desired=problem.desired[half],
        is_cutting=problem.is_cutting[half],
    )
    found, best = IteratedMirror(sample=sample)(problem), IteratedMirror()(sample)
    for name in ("cutoff", "relaxation"):
        assert found.detail[name] == best.detail[name]
    assert found.forward_runs < mirrored.forward_runs


def test_mirror_removes_a_constant_deviation():
    """A rigid plant with an offset is exactly what one mirror corrects."""
    _, path, is_cutting = rounded_square(TIME_STEP)
    shift = np.array([1e-4, -5e-5, 2e-5])
    rigid = lambda command: Motion(command + shift[None], jnp.zeros_like(command))
    problem = Problem(rigid, path, path, is_cutting.astype(float), TIME_STEP)
    found = Mirror()(problem)
    assert found.measures.max < 1e-15
    assert found.command_statistics.max_offset == pytest.approx(1e-4)
    assert found.forward_runs == 2


def test_gauss_newton_tells_the_share_of_its_steps(problem):
    told, steps = [], []
    method = GaussNewton(
        KNOTS,
        solver=LevenbergMarquardt(max_steps=2),
        on_step=lambda message, share: told.append((message, share)),
    )
    method(problem, on_progress=lambda message, error: steps.append(len(told)))
    rows = len(problem.desired)
    messages = [f"Gauss-Newton step {k} over {rows} tooth periods" for k in (1, 2)]
    assert [x for x in dict.fromkeys(message for message, _ in told)] == messages
    for message in messages:
        shares = [share for name, share in told if name == message]
        assert len(shares) > 1 and shares == sorted(shares) and shares[-1] == 1
    # The slopes are told before the step is.
    assert steps[0] == sum(message == messages[0] for message, _ in told)


def test_a_plant_that_explodes_is_told_and_does_not_win():
    """Any offset above 10 um makes this plant infinite."""
    _, path, is_cutting = rounded_square(TIME_STEP)

    def plant(command):
        is_far = jnp.any(jnp.abs(command - path) > 1e-5)
        actual = command + jnp.array([[1e-4, 0.0, 0.0]])
        return Motion(jnp.where(is_far, jnp.inf, actual), jnp.zeros_like(command))

    problem = Problem(plant, path, path, is_cutting.astype(float), TIME_STEP)
    assert Mirror()(problem).result is RESULTS.non_finite
    found = IteratedMirror(cutoffs=(5.0,), relaxations=(1.0,))(problem)
    assert found.result is RESULTS.successful
    assert found.detail["iterate"] == 0
    # The start, the one that explodes, and the result.
    assert found.forward_runs == 3


def test_progress_ends_the_mirror(problem):
    told = []

    def on_progress(message, error):
        told.append(message)
        return True

    found = IteratedMirror()(problem, on_progress=on_progress)
    assert len(told) == 1
    assert found.forward_runs < 40


@pytest.mark.slow
def test_joint_commands_need_no_tip():
    """Commands of another kind go through a plant that maps them to tips."""
    _, path, is_cutting = rounded_square(TIME_STEP)
    mixing = jnp.array([[0.5, 0.0, 0.1], [0.0, 0.4, 0.0], [0.2, 0.0, 0.3]])
    nominal = path @ np.linalg.inv(np.asarray(mixing))
    shift = jnp.array([[5e-5, 3e-5, 1e-5]])

    def plant(command):
        # The error comes and goes smoothly, as the clamped spline can follow.
        time = jnp.linspace(0.0, 1.0, len(path))[:, None]
        return Motion(
            command @ mixing + shift * jnp.sin(jnp.pi * time) ** 4, jnp.zeros_like(path)
        )

    problem = Problem(plant, nominal, path, is_cutting.astype(float), TIME_STEP)
    solver = LevenbergMarquardt(max_steps=10, damping=1e-6, cost_rtol=1e-6)
    found = GaussNewton(0.1, smoothness=0.0, solver=solver)(problem)
    before = GivenCommand()(problem)
    assert found.measures.rms < 0.02 * before.measures.rms


def test_measures_of_a_known_error():
    rows = 100
    path = np.zeros((rows, 3))
    path[:, 0] = 1e-3 * np.arange(rows)
    weights = (np.arange(rows) >= 50).astype(float)
    contour = np.zeros((rows, 3))
    contour[:, 1] = 1e-6 * np.arange(rows)
    problem = Problem(lambda c: c, path, path, weights, 0.01)
    command = path.copy()
    command[:, 2] = 0.5 * 3.0 * (0.01 * np.arange(rows)) ** 2
    motion = Motion(jnp.asarray(path + contour), jnp.zeros((rows, 3)))
    method = GivenCommand(command, motion)
    found, size = method(problem).measures, method(problem).command_statistics
    cut = 1e-6 * np.arange(50, 100)
    assert found.mean == pytest.approx(cut.mean())
    assert found.rms == pytest.approx(np.sqrt(np.mean(cut**2)))
    assert found.p95 == pytest.approx(np.percentile(cut, 95))
    assert found.max == pytest.approx(99e-6)
    assert size.max_acceleration == pytest.approx(3.0)
    assert size.p95_acceleration == pytest.approx(3.0)
    assert size.max_offset == pytest.approx(0.5 * 3.0 * 0.99**2)
    weights = np.where(np.arange(rows) < 50, 0.1, 1.0)
    half = method(dataclasses.replace(problem, is_cutting=weights)).measures
    assert half.rms < found.rms
    assert half.p95 == pytest.approx(np.percentile(1e-6 * np.arange(rows), 95))


def test_on_the_way_through_the_air_the_tool_stays_near_the_path():
    """No row that counts sees most of these offsets, which the bounds leave free."""
    _, path, is_cutting = rounded_square(TIME_STEP)
    is_cutting[len(path) // 3 : len(path) // 2] = False
    weights = is_cutting.astype(float)
    problem = Problem(soft_arm(TIME_STEP), path, path, weights, TIME_STEP)
    before = np.linalg.norm(GivenCommand()(problem).contour, axis=1)
    found = GaussNewton(30e-3)(problem)
    after = np.linalg.norm(found.contour, axis=1)
    assert after[~is_cutting].max() < 0.3 * before[~is_cutting].max()
    assert found.measures.rms < 5e-6


class Counted(eqx.Module):
    """A plant whose runs are counted."""

    plant: Any
    runs: list = eqx.field(static=True)

    def __call__(self, command):
        jax.debug.callback(lambda: self.runs.append(command.shape))
        return self.plant(command)


def test_gauss_newton_runs_nothing_twice(problem):
    counted = eqx.tree_at(lambda p: p.plant, problem, Counted(problem.plant, []))
    method = GaussNewton(KNOTS, solver=LevenbergMarquardt(max_steps=2))
    found = method(counted)
    jax.effects_barrier()
    last = found.history[-1]
    # Its start comes with the first linear system, its end with the last trial.
    assert (found.forward_runs, found.linearisations) == (last.evaluations, last.models)
    assert len(counted.plant.runs) == found.forward_runs + found.linearisations
    again = GivenCommand(found.command)(problem)
    np.testing.assert_allclose(found.motion.actual, again.motion.actual, atol=1e-12)


class Chattering(eqx.Module):
    """A tool that swings by a micrometre, as a chaotic map of all before decides.

    A change of the command grows by some hundred in every row.
    """

    def __call__(self, command):
        def step(state, row):
            state = jnp.sin(1e3 * (state + row))
            return state, state

        _, states = jax.lax.scan(step, jnp.zeros(3), command)
        return Motion(command + 1e-6 * states, jnp.zeros_like(command))


@pytest.mark.parametrize("rows", [80, 400])
def test_slopes_that_overflow_are_told_in_one_sentence(rows):
    path = np.linspace([0.0, 0.0, 0.0], [0.02, 0.01, 0.0], rows)
    problem = Problem(Chattering(), path, path, np.ones(rows), TIME_STEP)
    with pytest.raises(SimulationFailed, match=r"chatters.*no slopes there"):
        GaussNewton(KNOTS)(problem)
