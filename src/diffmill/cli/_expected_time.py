"""Expected time of a job, by counts of discs and edge elements in its rows."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .._job import Job

# Processor time of `simulate` for a row, fitted to what the jobs of
# `experiments/performance/run.py expected` take on two cores [ms]: at least; of a disc
# of an upright cutter, and more by its diameter in rays; of an edge element in space;
# of removal by a tilted tool of 50 rays in diameter, by the square of it.
_ROW, _DISC, _DISC_BY_RAYS = 0.04, 0.13, 0.0016
_ELEMENT, _TILTED = 0.24, 3.5
# A correction in runs, each of which leaves out the rigid cut: the simpler methods, the
# first and last runs, and a step of the optimiser [share, count, count].
_COUPLED, _OTHER_RUNS, _STEP_RUNS = 0.65, 6, 7
# A parameter of the sensitivity, in runs.
_PARAMETER_RUNS = 3


def expected_time_line(job: "Job") -> str:
    """Line on the expected time of `simulate` and `correct`.

    Args:
        job: The job.
    """
    run = _run_time(job)
    text = f"simulate about {spelled(run)}"
    if not job.is_rigid and job.correction.method.uses_linear_run:
        text += f", correct about {spelled(_correction_time(job, run))}"
    if job.simulation.has_sensitivity:
        runs = _PARAMETER_RUNS * len(job.parameter_names)
        text += f", the sensitivity about {spelled(_COUPLED * runs * run)} more"
    return (
        f"  expected: {text}, within a factor of 3; a first job of its kind compiles "
        "for a minute more, figures take some seconds"
    )


def expected_campaign_line(job: "Job", command: str, count: int) -> str:
    """Line on the expected time of a campaign on one worker.

    Args:
        job: One of its jobs.
        command: "simulate" or "correct".
        count: Number of jobs.
    """
    each = _run_time(job)
    if command == "correct":
        each = _correction_time(job, each)
    return (
        f"  expected: about {spelled(each)} a job once its programs are compiled, "
        f"{spelled(count * each)} of one worker, within a factor of 3; each kind of "
        "job compiles for half a minute more: other spindle speeds, sizes of the stock "
        "and choices are kinds of their own, other numbers are not"
    )


def _correction_time(job: "Job", run: float) -> float:
    """Time of a correction, from that of a simulation [s]."""
    uncertainty = job.correction.uncertainty
    members = 1 if uncertainty is None else uncertainty.draws
    runs = _OTHER_RUNS + _STEP_RUNS * job.correction.max_steps * members
    return _COUPLED * runs * run


def _run_time(job: "Job") -> float:
    """Time of a simulation [s]."""
    return 1e-3 * _row_time(job) * job.path.step_count


def _row_time(job: "Job") -> float:
    """Time of a row [ms]."""
    from ..process import EdgeElementsInSpace, FrozenStock
    from ..sim import MachiningProblem

    engagement = MachiningProblem.of(
        job.with_precision(), FrozenStock()
    ).process.engagement
    rays = 2 * job.cutter.nominal_radius / job.stock.spacing
    if not isinstance(engagement, EdgeElementsInSpace):
        discs = engagement.discs.count
        return _ROW + discs * (_DISC + _DISC_BY_RAYS * rays)
    edge = engagement.profile
    spent = _ROW + _ELEMENT * (edge.bottom + edge.corner + edge.side)
    return spent if engagement.is_upright else spent + _TILTED * (rays / 50) ** 2


def spelled(seconds: float) -> str:
    """Time in a unit that suits it, as text."""
    if seconds < 90:
        return f"{max(seconds, 1.0):.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
