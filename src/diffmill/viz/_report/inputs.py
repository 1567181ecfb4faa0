"""The inputs of all figures, from a job and its solutions."""

import concurrent.futures
from collections.abc import Mapping
from typing import TypedDict

import numpy as np

from ..._jax_config import give_back_memory
from ..._job import Job
from ..._padding import LONGEST
from ..._result import RESULTS
from ...numerics import CachedJit
from ...robot import Robot
from ...sim import Replay, Solution, ToothChip
from ...workpiece import SurfaceError
from .._figure.dexels import CutDexels
from .._figure.forces import ForceTrace

# A force as near to the median, relative to it, is typical.
_TYPICAL = 0.01


class FigureInputs(TypedDict):
    """Keyword arguments of `write_figures` beside the dataset."""

    forces: ForceTrace | None
    chip: ToothChip | None
    chip_row: int
    dexels: CutDexels
    surfaces: dict[str, SurfaceError]
    robot: Robot | None


def figure_inputs(
    job: Job,
    cases: Mapping[str, Solution],
    surfaces: Mapping[str, SurfaceError] | None = None,
    *,
    chosen: str = "corrected",
) -> FigureInputs:
    """Inputs of `write_figures` beside the dataset.

    The process runs once more, without the robot, on the actual poses of the first case
    up to a typical row, for the force at every angle and the chip of a revolution.

    Args:
        job: The job.
        cases: Its solutions by case, the uncorrected one first; for a simulation
            one solution under the name "predicted".
        surfaces: Surface errors of the cases, by name; computed if not given.
        chosen: Name of the case that became the corrected program.

    Returns:
        The inputs; forces, chip and ray ends are those of the first case, surface
        errors those of the first and the chosen one, if they cut anything.
    """
    name, first = next(iter(cases.items()))
    # More maps would make the report long without telling more.
    mapped = {key: case for key, case in cases.items() if key in (name, chosen)}
    step = _typical_step(first)
    compare = lambda: _surfaces(mapped) if surfaces is None else surfaces
    if job.path.step_count > LONGEST:
        again = Replay.of_solution(job, first, chip_row=step or 1)
        # Programs of its segments are as large as what the surfaces take.
        CachedJit.forget_all()
        give_back_memory()
        maps = compare()
        give_back_memory()
    else:
        with concurrent.futures.ThreadPoolExecutor(1) as pool:
            # Another core compares the surfaces while compiled code runs here.
            compared = pool.submit(compare)
            again = Replay.of_solution(job, first, chip_row=step or 1)
            maps = compared.result()
    time, window = np.asarray(first.time), None
    # A run that overflowed is not the process of the figure's caption.
    if bool(again.run.result == RESULTS.successful) and len(again.rows) > 1:
        rows = np.array([again.rows[0] - 1, *again.rows])
        samples = again.forces()
        samples = np.concatenate([samples[:1], samples])
        window = ForceTrace.from_periods(time[rows], samples)
    forces = ForceTrace.of_rows(time, first.force, first.force_range, window=window)
    return FigureInputs(
        forces=forces,
        chip=None if step is None else again.tooth_chip(),
        chip_row=step or 1,
        dexels=CutDexels.from_stocks(first.stock, first.rigid.stock),
        surfaces={
            key: error
            for key, error in maps.items()
            if key in mapped and len(error.error)
        },
        robot=job.robot,
    )


def _surfaces(cases: Mapping[str, Solution]) -> dict[str, SurfaceError]:
    """Surface errors of cases, none where all was cut away."""
    ideal = next(iter(cases.values())).rigid.stock
    if not float(ideal.volume()) > 0:
        return {}
    stocks = [case.stock for case in cases.values()]
    errors = SurfaceError.of_stocks(stocks, ideal, leaves_out_raw=True)
    return dict(zip(cases, errors, strict=True))


def _typical_step(solution: Solution) -> int | None:
    """First cutting step whose force is that of the median to 1 %, or the nearest.

    An early one takes a short replay. None if none cuts.
    """
    length = np.linalg.norm(np.asarray(solution.force), axis=1)
    cutting = np.asarray(solution.is_cutting) & np.isfinite(length) & (length > 0)
    cutting[0] = False
    if not cutting.any():
        return None
    median = np.median(length[cutting])
    distance = np.where(cutting, np.abs(length / median - 1), np.inf)
    return int(np.argmax(distance <= max(_TYPICAL, distance.min())))
