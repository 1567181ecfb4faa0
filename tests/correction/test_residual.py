"""The correction as pure functions, in the optimisers of other packages."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import optimistix
import pytest
import scipy.optimize
from correction.spring_mass import rounded_square, soft_arm
from slides_job import write_slides_job

import diffmill as dm
from diffmill.correction import GivenCommand, Problem, residual

TIME_STEP = 5e-3
BEND = "G21 G17 G90 G94\nG0 X-5.5 Y4 Z-0.8\nG1 X3 F6000\nM2\n"


STOCK = dm.workpiece.box([0, 0, 0], [1, 1, 1], 0.5)


@pytest.fixture(scope="module")
def fit():
    _, path, is_cutting = rounded_square(TIME_STEP, side=10e-3)
    plant = soft_arm(TIME_STEP, damping_ratio=0.2)
    problem = Problem(plant, path, path, is_cutting.astype(float), TIME_STEP)
    return residual(problem, knot_spacing=40e-3)


@pytest.fixture(scope="module")
def least(fit):
    """The least cost, by the least squares of scipy."""
    errors = jax.jit(lambda x: fit.residual(x.reshape(fit.start.shape), fit.args))
    slopes = jax.jit(jax.jacfwd(errors))
    found = scipy.optimize.least_squares(
        errors,
        np.zeros(fit.start.size),
        jac=slopes,  # pyright: ignore[reportArgumentType]
        bounds=(-1, 1),
        max_nfev=12,
    )
    return found.cost


def rms(fit, unknowns):
    problem, command = fit.args.problem, fit.command(unknowns, fit.args)
    return GivenCommand(command)(problem).measures.rms


def test_a_start_is_the_uncorrected_command(fit):
    np.testing.assert_array_equal(
        fit.command(fit.start, fit.args), fit.args.problem.nominal
    )


class Flat(dm.correction.AbstractObjective):
    """Errors in a table instead of a row."""

    def errors(self, problem, motion, lag_weight):
        return problem.contour(motion)


@pytest.mark.parametrize("objective", ["surface", Flat])
def test_what_is_no_objective_is_refused_before_anything_runs(fit, objective):
    # The type check of the tests comes first.
    with pytest.raises((ValueError, TypeError), match="objective"):
        residual(fit.args.problem, objective=objective)


def test_errors_that_are_no_row_are_refused(fit):
    own = residual(fit.args.problem, objective=Flat())
    with pytest.raises(ValueError, match=r"Flat\.errors.*\(error,\)"):
        own.residual(own.start, own.args)


def test_optimistix_finds_the_least_squares(fit, least):
    solver = optimistix.LevenbergMarquardt(rtol=1e-4, atol=1e-4)
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        found = optimistix.least_squares(
            fit.residual, solver, fit.start, fit.args, max_steps=30
        )
    assert float(fit.cost(found.value, fit.args)) < 1.05 * least
    assert rms(fit, found.value) < 0.2 * rms(fit, fit.start)


def test_optax_descends_as_its_schedule_says(fit):
    optimiser, slope = optax.adam(0.02), jax.jit(jax.value_and_grad(fit.cost))
    x, state = fit.start, optimiser.init(fit.start)
    with jax.numpy_dtype_promotion("standard"):
        for _ in range(60):
            _, gradient = slope(x, fit.args)
            update, state = optimiser.update(gradient, state)
            x = optax.apply_updates(x, update)
    assert fit.cost(x, fit.args) < 0.2 * fit.cost(fit.start, fit.args)


def test_arguments_of_plants_of_one_shape_are_mapped(fit):
    softer = eqx.tree_at(lambda a: a.problem.plant.stiffness, fit.args, replace_fn=half)
    both = jax.vmap(fit.cost, in_axes=(None, 0))(
        fit.start, dm.stack([fit.args, softer])
    )
    expected = [fit.cost(fit.start, args) for args in (fit.args, softer)]
    np.testing.assert_allclose(both, expected, rtol=1e-9)
    assert both[0] != both[1]


def half(stiffness):
    return 0.5 * stiffness


@pytest.fixture
def slides(tmp_path):
    file = write_slides_job(tmp_path, 'knot_spacing = "20 ms"', program=BEND)
    return dm.load_job(file)


def test_jobs_of_other_shapes_are_not_stacked(slides):
    finer = dataclasses.replace(slides.simulation, substeps=8)
    with pytest.raises(ValueError, match=r"`simulation\.substeps` \(4 and 8\)"):
        dm.stack([slides, dataclasses.replace(slides, simulation=finer)])
    wider = dataclasses.replace(slides, stock=STOCK)
    with pytest.raises(ValueError, match="number 3 differ in the shape of `stock"):
        dm.stack([slides, slides, wider])
    with pytest.raises(ValueError, match="empty"):
        dm.stack([])


def test_paths_of_a_stack_are_as_long_as_the_longest(slides):
    longer = dataclasses.replace(
        slides, name="rest", path=slides.path.with_standstill(3)
    )
    both = dm.stack([slides, longer])
    rows = slides.path.step_count
    assert both.path.positions.shape == (2, rows + 6, 3)
    np.testing.assert_array_equal(both.path.row_count, [rows, rows + 6])


@pytest.mark.slow
def test_the_gradient_of_a_job_is_that_of_differences(slides):
    told = []
    fit = residual(slides, on_progress=lambda *said: told.append(said))
    count = slides.path.step_count
    assert told[0] == (f"rigid cut: {count} tooth periods", 0.0)
    rng = np.random.default_rng(0)
    x = 0.02 * jnp.asarray(rng.normal(size=fit.start.shape))
    v = jnp.asarray(rng.normal(size=x.shape))
    gradient = jax.jit(jax.grad(fit.cost))(x, fit.args)
    cost = jax.jit(fit.cost)
    step = 1e-5  # 10 nm
    ahead, behind = cost(x + step * v, fit.args), cost(x - step * v, fit.args)
    slope = float(ahead - behind) / (2 * step)
    assert float(jnp.vdot(gradient, v)) == pytest.approx(slope, rel=1e-4)


@pytest.mark.slow
def test_a_stack_of_jobs_is_simulated_as_one_after_the_other(slides):
    other = eqx.tree_at(lambda j: j.law.K_tc, slides, 8e8)
    longer = dataclasses.replace(other, path=other.path.with_standstill(3))
    forces = jax.jit(jax.vmap(lambda job: dm.simulate(job).force))(
        dm.stack([slides, longer])
    )
    for force, job in zip(forces, (slides, longer), strict=True):
        alone = dm.simulate(job).force
        np.testing.assert_allclose(force[: len(alone)], alone, atol=1e-9)
