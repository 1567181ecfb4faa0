"""The inputs of all figures, from a job and its solutions."""

from collections.abc import Mapping
from typing import TypedDict

import numpy as np

from ..._job import Job
from ..._result import RESULTS
from ...process import ThroughRays
from ...sim import (
    Solution,
    actual_poses,
    job_process,
    replay_process,
    tooth_chip,
    with_precision,
)
from ...workpiece import SurfaceError, surface_error
from .._figure.chip import ChipChart
from .._figure.dexels import CutDexels
from .._figure.forces import ForceRecord

# The report's maps: more cases would make it long without telling more.
_MAPPED = ("predicted", "uncorrected", "corrected")


class FigureInputs(TypedDict):
    """Keyword arguments of `write_figures` beside the dataset."""

    forces: ForceRecord | None
    chip: ChipChart | None
    dexels: CutDexels
    surfaces: dict[str, SurfaceError]


def figure_inputs(job: Job, cases: Mapping[str, Solution]) -> FigureInputs:
    """Return what `write_figures` draws beside the dataset.

    The process runs once more, without the robot, on the actual poses of the first
    case, to keep the force at every angle; and up to one revolution for its chip.

    Args:
        job: The job.
        cases: Its solutions by case, the uncorrected one first; for a simulation
            one solution under the name "predicted".

    Returns:
        The inputs; forces, chip and ray ends are those of the first case.
    """
    job = with_precision(job)
    first = next(iter(cases.values()))
    replay = replay_process(job, first)
    samples = replay.instantaneous_force
    forces = None
    # What overflowed is not the process of the figure's caption.
    if samples is not None and bool(replay.result == RESULTS.successful):
        forces = ForceRecord.from_periods(np.asarray(first.time), np.asarray(samples))
    return FigureInputs(
        forces=forces,
        chip=_chip(job, first),
        dexels=CutDexels.from_stocks(first.stock, first.rigid.stock),
        surfaces={
            name: surface_error(
                solution.stock, solution.rigid.stock, leaves_out_raw=True
            )
            for name, solution in cases.items()
            if name in _MAPPED and bool(solution.rigid.stock.volume() > 0)
        },
    )


def _chip(job: Job, solution: Solution) -> ChipChart | None:
    """Return the chip of a typical revolution, None if nothing is cut."""
    step = _typical_step(solution)
    if step is None:
        return None
    process = job_process(job, ThroughRays())
    found = tooth_chip(process, actual_poses(job, solution), step=step)
    return ChipChart.from_tooth(found, process.engagement.angles)


def _typical_step(solution: Solution) -> int | None:
    """Return the cutting step whose force is nearest to the median; None if none."""
    length = np.linalg.norm(np.asarray(solution.force), axis=1)
    cutting = np.asarray(solution.is_cutting) & np.isfinite(length) & (length > 0)
    cutting[0] = False
    if not cutting.any():
        return None
    distance = np.abs(length - np.median(length[cutting]))
    return int(np.argmin(np.where(cutting, distance, np.inf)))
