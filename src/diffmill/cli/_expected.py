"""Expected time and memory of a job.

The time follows from counts of discs and edge elements in its rows, the memory from the
bytes of its rows and rays.
"""

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .._job import Job
    from ..correction import SegmentRows

# Processor time of `simulate` for a row, fitted to what the jobs of
# `experiments/performance/run.py expected` take on two cores [ms]: at least; of a disc
# of an upright cutter, and more by its diameter in rays; of an edge element in space;
# of removal by a tilted tool of 50 rays in diameter, by the square of it.
_ROW, _DISC, _DISC_BY_RAYS = 0.04, 0.13, 0.0016
_ELEMENT, _TILTED = 0.24, 3.5
# Of it where several tooth periods share an engagement update [share].
_ADAPTIVE = 0.65
# A correction in runs, each of which leaves out the rigid cut: the simpler methods, the
# first and last runs, and a step of the optimiser [share, count, count].
_COUPLED, _OTHER_RUNS, _STEP_RUNS = 0.65, 6, 7
# Analyses and figures of a long path, of a row [ms] and of an end of a ray [us].
_ANALYSED_ROW, _COMPARED_END = 0.17, 15
# Memory of a process with its libraries and compiled programs, measured [byte]; rows
# that stay, and as many again in what is made of them; stocks beside those of the
# cases; of an end of a ray, while surfaces are compared [byte].
_PROGRAMS, _COPIES, _STOCKS, _END_BYTES = 7e8, 3, 4, 250
# Numbers of a row of a rigid cut, and of a solution beside its joints.
_RIGID_NUMBERS, _SOLUTION_NUMBERS = 18, 26
# Cases of a correction; its linear run and programs beside those of a simulation, and
# what it holds of a row [byte].
_CASES, _LINEAR_PROGRAMS, _LINEAR_ROW = 4, 5e7, 3.5e5
# A parameter of the sensitivity, in runs.
_PARAMETER_RUNS = 3


def expected_time_line(job: "Job") -> str:
    """Line on the expected time and memory of `simulate` and `correct`.

    Args:
        job: The job.
    """
    from .._padding import LONGEST

    run = _run_time(job)
    is_adaptive = job.simulation.resolution == "adaptive"
    text = f"simulate about {spelled(run * (_ADAPTIVE if is_adaptive else 1))}"
    if job.path.step_count > LONGEST:
        text += f" and {spelled(_analyses_time(job))} of analyses and figures"
    text += f", {_spelled_bytes(_memory(job, 1))}"
    if not job.is_rigid and job.correction.method.uses_linear_run:
        time, memory = _correction_time(job, run), _correction_memory(job)
        text += f"; correct about {spelled(time)}, {_spelled_bytes(memory)}"
    if job.simulation.has_sensitivity:
        runs = _PARAMETER_RUNS * len(job.parameter_names)
        text += f", the sensitivity about {spelled(_COUPLED * runs * run)} more"
    return (
        f"  expected: {text}; time within a factor of 3, memory of 2; a first job of "
        "its kind compiles for a minute more, figures take some seconds"
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
    runs = _STEP_RUNS * job.correction.max_steps * members
    segments = _segments(job)
    if segments is not None:
        # Gone through twice, and rows of an overlap in two segments.
        runs *= 2 * segments.length / (segments.length - segments.overlap)
    runs += _OTHER_RUNS
    return _COUPLED * runs * run


def _segments(job: "Job") -> "SegmentRows | None":
    """Rows of the segments of a correction; None for the path as a whole."""
    from ..correction import SegmentRows, UnsuitableSettings

    try:
        return SegmentRows.of_job(job, has_own_objective=False)
    except UnsuitableSettings:
        # The correction refuses what a simulation takes.
        return None


def _correction_memory(job: "Job") -> float:
    """Peak memory of a correction [byte]."""
    segments = _segments(job)
    at_once = job.path.step_count if segments is None else segments.length
    return _memory(job, _CASES) + _LINEAR_PROGRAMS + _LINEAR_ROW * at_once


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


def _analyses_time(job: "Job") -> float:
    """Time of analyses and figures of a long path [s]."""
    return 1e-3 * _ANALYSED_ROW * job.path.step_count + 1e-6 * _COMPARED_END * _ends(
        job
    )


def _memory(job: "Job", cases: int) -> float:
    """Peak memory of a run with its analyses and figures [byte]."""
    rows = job.path.step_count * _row_bytes(job, cases)
    stocks = (_STOCKS + cases) * job.stock.memory_with(job.stock.interval_counts).needed
    return _PROGRAMS + _COPIES * rows + stocks + _END_BYTES * _ends(job)


def _row_bytes(job: "Job", cases: int) -> float:
    """Bytes of a row that stay: of the path, the rigid cut and the solutions."""
    import jax
    import numpy as np

    path = sum(x.nbytes for x in jax.tree.leaves(job.path) if hasattr(x, "nbytes"))
    joints = 0 if job.robot is None else job.robot.joint_count
    numbers = _RIGID_NUMBERS + cases * (_SOLUTION_NUMBERS + 2 * joints)
    item = np.dtype(job.simulation.precision).itemsize
    return path / job.path.step_count + numbers * item


def _ends(job: "Job") -> int:
    """Number of ends of the rays, of which each holds one interval."""
    return sum(2 * math.prod(x.ends.shape[:2]) for x in job.stock.families)


def _spelled_bytes(count: float) -> str:
    """Memory as text."""
    return f"{count / 1e9:.2f} GB"


def spelled(seconds: float) -> str:
    """Time in a unit that suits it, as text."""
    if seconds < 90:
        return f"{max(seconds, 1.0):.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
