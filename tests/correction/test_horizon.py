"""Segments with a look ahead against the whole path, on a cheap plant."""

import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from correction.spring_mass import SpringMass, soft_arm, square_problem
from scipy import sparse

from diffmill import RESULTS
from diffmill.correction import (
    AbstractPiece,
    AbstractPieces,
    GaussNewton,
    LinearLimits,
    Problem,
    RecedingHorizon,
    SplineOffsets,
)
from diffmill.optimise import LevenbergMarquardt
from diffmill.robot import Controller

TIME_STEP = 3.75e-3
KNOTS = 30e-3
# Rings off within the overlap, so that what comes behind it does not matter.
PLANT = soft_arm(TIME_STEP, damping_ratio=0.1)
METHOD = GaussNewton(
    KNOTS, solver=LevenbergMarquardt(max_steps=6, damping=1e-6, cost_rtol=1e-3)
)


class SpringPiece(AbstractPiece):
    """Some rows of the plant."""

    plant: SpringMass
    state: tuple

    def run(self, command):
        """Run from the state."""
        return self.plant.run(self.state, command)


class SpringPieces(AbstractPieces):
    """The plant, piece by piece."""

    plant: SpringMass

    def begin(self, command):
        """Start at rest."""
        return self.plant.at_rest(command)

    def piece(self, state, rows):
        """Go on from a state."""
        del rows
        return SpringPiece(self.plant, state)


class LedMass(eqx.Module):
    """The plant behind a controller."""

    plant: SpringMass
    controller: Controller

    def __call__(self, command):
        return self.plant(self.controller.motors(command, TIME_STEP))


class LedPiece(AbstractPiece):
    """Some rows of it."""

    led: LedMass
    state: tuple

    def run(self, command):
        """Run from the state."""
        plant, memory = self.state
        motors, memory = self.led.controller.follow(command, TIME_STEP, memory)
        motion, plant = self.led.plant.run(plant, motors)
        return motion, (plant, memory)


@eqx.filter_jit
def _begun(controller, command, before, ahead):
    memory = controller.begin(command, TIME_STEP, before, ahead)
    return controller.follow(command, TIME_STEP, memory).motors, memory


class LedPieces(AbstractPieces):
    """It, piece by piece."""

    led: LedMass

    @property
    def preview_rows(self):
        """Return those that the controller knows."""
        return self.led.controller.span(TIME_STEP).ahead

    def begin(self, command):
        """Start at rest."""
        controller = self.led.controller
        motors, memory = _begun(controller, command, *controller.span(TIME_STEP))
        return self.led.plant.at_rest(motors), memory

    def piece(self, state, rows):
        """Go on from a state."""
        del rows
        return LedPiece(self.led, state)


@pytest.fixture(scope="module")
def problem():
    return square_problem(TIME_STEP, damping_ratio=0.1)


def horizon(problem, method=METHOD, **options):
    pieces = SpringPieces(problem.plant)
    return RecedingHorizon(
        pieces, method, **{"horizon": 200, "overlap": 100, **options}
    )


@pytest.fixture(scope="module")
def segmented(problem):
    saved, told = [], []
    found = horizon(problem)(
        problem,
        on_progress=lambda *found: told.append(found),
        on_checkpoint=saved.append,
    )
    return found, saved, told


def test_segments_find_what_the_whole_path_finds(problem, segmented):
    whole = METHOD(problem)
    found, saved, _ = segmented
    assert found.detail["segment_count"] == 4
    assert len(saved) == 4 * found.detail["sweeps"] == 8
    # Two sweeps come a little deeper into a flat valley than the steps of one run.
    assert -0.05 < found.measures.rms / whole.measures.rms - 1 < 0.01
    assert whole.measures.rms < 1e-5


def test_unknowns_at_the_bound_are_counted(problem):
    tight = dataclasses.replace(problem, max_offset=2e-5)
    found = horizon(tight)(tight)
    offset = np.abs(np.asarray(found.command) - problem.nominal)
    assert offset.max() == pytest.approx(2e-5, rel=1e-3)
    assert 0 < found.detail["bound_count"] < found.detail["unknowns"]
    whole = METHOD(tight)
    assert 0 < whole.detail["bound_count"] < whole.detail["unknowns"]
    # About one unknown per eight rows that are at the bound throughout.
    for one in (found, whole):
        at = np.sum(np.abs(np.asarray(one.command) - problem.nominal) > 1.9999e-5)
        assert one.detail["bound_count"] > 0.5 * at / 8


def test_progress_tells_the_error_so_far_and_the_time_left(segmented):
    found, _, told = segmented
    assert [message.split(",")[0] for message, _ in told] == [
        f"segment {k} of {len(told)}" for k in range(1, len(told) + 1)
    ]
    assert all(message.endswith(" s left") for message, _ in told)
    assert told[-1][0].endswith(" 0 s left")
    assert told[-2][1] == pytest.approx(found.measures.rms, rel=0.2)


@pytest.mark.parametrize("at", [0, -1])
def test_a_resumed_run_gives_the_same_to_the_bit(problem, segmented, at):
    found, saved, _ = segmented
    more = []
    again = horizon(problem)(problem, resume=saved[at], on_checkpoint=more.append)
    np.testing.assert_array_equal(again.command, found.command)
    np.testing.assert_array_equal(again.contour, found.contour)
    assert len(more) == len(saved) - 1 - (at % len(saved))
    assert [s.cost for s in again.history] == [s.cost for s in found.history]


@pytest.fixture(scope="module")
def led(problem):
    """The problem behind a controller, at rest before and after it as in a job."""
    controller = Controller(
        interpolation_cycle=12e-3,
        moving_average=48e-3,
        bandwidth=10.0,
        damping_ratio=0.707,
    )
    rest = 3 * controller.span(TIME_STEP).ahead
    at = np.clip(np.arange(-rest, len(problem.nominal) + rest), 0, None)
    path = problem.nominal[np.minimum(at, len(problem.nominal) - 1)]
    weights = np.pad(problem.is_cutting, rest)
    return Problem(LedMass(PLANT, controller), path, path, weights, TIME_STEP)


def test_segments_through_a_controller_do_what_they_tell(led):
    """What has been run stays: the next segment holds what was looked ahead to."""
    told, saved = [], []
    hasty = eqx.tree_at(lambda m: m.solver.max_steps, METHOD, 2)
    method = RecedingHorizon(
        LedPieces(led.plant), hasty, horizon=200, overlap=100, sweeps=1
    )
    found = method(
        led, on_progress=lambda *found: told.append(found), on_checkpoint=saved.append
    )
    # The last segment is not run by itself.
    rows = int(saved[-2]["row"])
    square = np.sum(found.contour[:rows] ** 2, axis=1)
    rms = np.sqrt(np.average(square, weights=led.is_cutting[:rows]))
    assert told[-2][1] == pytest.approx(rms, rel=1e-9)
    again = method(led, resume=saved[1])
    np.testing.assert_array_equal(again.command, found.command)


@pytest.mark.slow
def test_segments_through_a_controller_find_what_the_whole_path_finds(led):
    whole = METHOD(led)
    method = RecedingHorizon(LedPieces(led.plant), METHOD, horizon=200, overlap=100)
    found = method(led)
    assert found.detail["segment_count"] == 5
    assert found.measures.rms < 1.02 * whole.measures.rms
    assert whole.measures.rms < 1e-5


def test_the_command_is_a_spline_of_the_whole_program(problem, segmented):
    offset = np.asarray(segmented[0].command) - problem.nominal
    spline = SplineOffsets(len(offset), TIME_STEP, KNOTS)
    np.testing.assert_allclose(
        offset,
        spline.offsets(jnp.asarray(spline.fit(offset))),
        atol=1e-12 * np.abs(offset).max(),
    )


@pytest.mark.parametrize("ahead", [0, 19])
@pytest.mark.parametrize("first", [0, 8, 37, 411])
def test_a_window_is_the_spline_in_its_rows(first, ahead):
    spline, count = SplineOffsets(531, TIME_STEP, KNOTS), 120
    window = spline.window(first, count, preview_rows=ahead)
    c = np.random.default_rng(0).normal(size=(spline.coefficient_count, 2))
    full = np.pad(c, ((3, 13), (0, 0)))[window.place()]
    total = count + ahead
    wanted = np.pad(np.asarray(spline.offsets(jnp.asarray(c))), ((0, total), (0, 0)))
    np.testing.assert_allclose(
        window.offsets(jnp.asarray(full)), wanted[first : first + total], atol=1e-14
    )
    # What may change leaves the first row alone, and those that have been looked at.
    free = np.where(np.asarray(window.is_free)[:, None], full, 0)
    assert np.all(np.asarray(window.offsets(jnp.asarray(free)))[: ahead + 1] == 0)
    assert window.is_free.sum() > (count - ahead) / 8 - 6


@pytest.mark.parametrize("count", [119, 120, 121, 122])
def test_a_window_changes_one_coefficient_that_acts_up_to_the_next_knot(count):
    spline, first = SplineOffsets(531, TIME_STEP, KNOTS), 8
    window = spline.window(first, count)
    acts = np.asarray(spline.offsets(jnp.eye(spline.coefficient_count))) != 0
    # The places of a program begin with three that are held at zero.
    places = np.asarray(window.place())[np.asarray(window.is_free)] - 3
    behind = first + count
    assert not acts[behind:, places[:-1]].any()
    assert acts[:behind, places[-1]].any()
    assert acts[behind:, places[-1]].sum() < spline.actual_spacing / TIME_STEP
    assert acts[behind:, places[-1] + 1].any()


def test_segments_that_have_not_settled_are_told(problem, segmented):
    found = segmented[0]
    is_settled = found.detail["unsettled_segments"] == 0
    assert is_settled == bool(found.result == RESULTS.successful)
    hasty = eqx.tree_at(lambda m: m.solver.max_steps, METHOD, 1)
    again = horizon(problem, hasty, horizon=400, sweeps=1)(problem)
    assert again.detail["unsettled_segments"] == again.detail["segment_count"]
    assert bool(again.result == RESULTS.not_converged)


def test_a_limit_of_all_axes_holds_across_seams(problem):
    """As those of joints are: x and y together may go half as far as they would."""
    free = horizon(problem, horizon=400, sweeps=1)(problem)
    together = lambda found: np.sum((found.command - problem.nominal)[:, :2], axis=1)
    most = 0.5 * together(free).max()
    spline = SplineOffsets(len(problem.nominal), TIME_STEP, KNOTS)
    basis = np.asarray(spline.offsets(jnp.eye(spline.coefficient_count)))
    matrix: Any = sparse.kron(basis, np.array([[1.0, 1.0, 0.0]]), "csr")
    bound = np.full(len(problem.nominal), most)
    limit = LinearLimits(matrix, -np.inf * bound, bound, "joints")
    method = dataclasses.replace(METHOD, limits=(limit,))
    held = horizon(problem, method, horizon=400, sweeps=1)(problem)
    assert 0.98 * most < together(held).max() <= most * (1 + 1e-9)
    assert held.measures.rms > free.measures.rms


def test_settings_that_cannot_be_are_refused(problem):
    with pytest.raises(ValueError, match="below `horizon`"):
        horizon(problem, overlap=200)
    with pytest.raises(ValueError, match=r"`sweeps`.* 1"):
        horizon(problem, sweeps=0)


@pytest.mark.slow
def test_a_second_sweep_forgets_what_the_start_had_behind_a_segment(problem):
    # An overlap far shorter than the arm rings, and a path from a poor start.
    whole = METHOD(problem).measures.rms
    rms = [horizon(problem, overlap=50, sweeps=n)(problem).measures.rms for n in (1, 2)]
    assert rms[1] < 0.995 * rms[0]
    assert rms[1] < 1.01 * whole


def test_a_sweep_that_another_follows_takes_half_of_the_steps(problem):
    # No decrease is too small, so that a segment takes as many steps as it may.
    solver = dataclasses.replace(METHOD.solver, max_steps=2, cost_rtol=0.0)
    method = dataclasses.replace(METHOD, solver=solver)
    counts = [len(horizon(problem, method, sweeps=n)(problem).history) for n in (1, 2)]
    assert counts[1] == 1.5 * counts[0]


def test_gauss_newton_goes_on_as_if_it_had_not_been_interrupted(problem):
    kept = []
    method = eqx.tree_at(lambda m: m.solver.max_steps, METHOD, 3)
    found = method(problem, on_checkpoint=kept.append)
    assert len(kept) == len(found.history) > 1
    for state in kept:
        again = method(problem, resume=state)
        np.testing.assert_array_equal(again.command, found.command)
        assert [s.cost for s in again.history] == [s.cost for s in found.history]
        # Neither the motion at the best point is kept nor its linear system.
        assert again.linearisations - found.linearisations in (0, 1)
        assert again.forward_runs - found.forward_runs in (0, 1)


def test_a_state_that_does_not_fit_is_refused(problem, segmented):
    _, saved, _ = segmented
    method, state = horizon(problem), dict(saved[0])
    place = next(name for name in state if name.startswith("state/"))
    for rows, dtype in ((2, float), (1, int)):
        other = state | {place: np.zeros((rows, 7), dtype)}
        with pytest.raises(ValueError, match="other shapes or types"):
            method(problem, resume=other)
    del state[place]
    with pytest.raises(ValueError, match="another structure"):
        method(problem, resume=state)


@pytest.mark.slow
def test_a_limit_of_the_command_holds_across_seams(problem, segmented):
    free = segmented[0].command_statistics
    rate = np.abs(np.diff(problem.nominal, 2, axis=0)).max() / TIME_STEP**2
    limit = 0.5 * (rate + free.max_acceleration)
    method = eqx.tree_at(lambda m: m.max_acceleration, METHOD, limit)
    found = horizon(problem, method)(problem)
    held = np.abs(np.diff(np.asarray(found.command), 2, axis=0)) / TIME_STEP**2
    assert limit * 0.98 < held.max() < limit * (1 + 1e-9)
