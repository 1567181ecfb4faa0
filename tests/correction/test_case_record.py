"""What a correction remembers of its methods, and what each of them cost."""

import dataclasses

import numpy as np
import pytest
from correction.spring_mass import rounded_square, soft_arm

from diffmill import RESULTS
from diffmill.correction import AbstractMethod, GivenCommand, Problem
from diffmill.correction._core.method import corrected
from diffmill.correction._job.case_runner import CaseRecord

TIME_STEP = 3.75e-3


class Unsettled(AbstractMethod):
    """Finds half of the path with five linear systems, and has not settled."""

    calls: list

    def __call__(self, problem, *, start=None, on_progress=None):
        self.calls.append(start)
        command = 0.5 * np.asarray(problem.nominal)
        found = corrected(problem, command, forward_runs=3, linearisations=5)
        return dataclasses.replace(found, result=RESULTS.not_converged)


@pytest.fixture(scope="module")
def problem():
    _, path, is_cutting = rounded_square(TIME_STEP)
    weights = is_cutting.astype(float)
    return Problem(soft_arm(TIME_STEP), path, path, weights, TIME_STEP)


def all_of(record, problem, calls):
    """A start in two parts, then the method that begins there."""
    first = record.prepare("first", Unsettled(calls), problem)
    record.prepare("second", GivenCommand(first.command), problem)
    record.run("corrected", Unsettled(calls), problem, start=first.command)


def test_a_start_is_no_case_but_costs(problem):
    record, calls = CaseRecord(None, None, None), []
    all_of(record, problem, calls)
    assert list(record.methods) == list(record.wall_time) == ["corrected"]
    found = record.methods["corrected"]
    # Four runs and five linear systems each time, and one run between.
    assert (found.forward_runs, found.linearisations) == (9, 10)
    record.run("another", GivenCommand(), problem)
    assert record.methods["another"].forward_runs == 1


def test_a_start_is_taken_up_and_a_case_that_has_not_settled_runs_again(problem):
    saved, calls = [], []
    record = CaseRecord(None, saved.append, None)
    all_of(record, problem, calls)
    again, more = CaseRecord(None, saved.append, saved[-1]), []
    all_of(again, problem, more)
    assert len(calls) == 2 and len(more) == 1
    one, other = (r.methods["corrected"] for r in (record, again))
    assert (one.forward_runs, one.linearisations) == (
        other.forward_runs,
        other.linearisations,
    )
    np.testing.assert_array_equal(more[0], calls[1])
    assert again.wall_time["corrected"] > 0


def test_what_is_told_within_a_method_comes_with_all_before(problem):
    saved = []
    record = CaseRecord(None, saved.append, None)
    record.run("uncorrected", GivenCommand(), problem)
    record.keep("first", {"z": np.arange(3.0)})
    resumed = CaseRecord(None, None, saved[-1])
    np.testing.assert_array_equal(resumed.kept("first")["z"], np.arange(3.0))
    resumed.run("uncorrected", Unsettled([]), problem)
    assert resumed.methods["uncorrected"].linearisations == 0
