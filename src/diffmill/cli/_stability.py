"""Stability lobes of a job: the depth that each spindle speed allows."""

import math
import pathlib
import sys
from typing import TYPE_CHECKING

import numpy as np

from .._jax_config import configure_jax
from .._messages import printable
from .._results_folder import ResultsFolder
from ._run_job import with_job
from ._session.attempts import Attempts
from ._session.errors import (
    BadInput,
    bad_input,
    interruption_leaves,
    locked_folder,
)
from ._session.progress import Progress

if TYPE_CHECKING:
    from .._job import Job
    from ..sim import StabilityLobes

_RPM, _SPEEDS = math.pi / 30, 61
_ASSUMED = (
    "at every speed the feed of a tooth, the arc of the cut and the pose of the "
    "machine stay those of the program; process damping is not modelled, so limits at "
    "low speeds are low"
)


def run_stability(
    file: pathlib.Path,
    speeds: tuple[float, ...],
    out: pathlib.Path | None,
    *,
    force: bool,
    progress: Progress,
    allow_outside: bool,
) -> int:
    """Write the stability lobes of a job; return the exit code.

    Args:
        file: The job file.
        speeds: Lowest and highest spindle speed [rpm]; none for some about its own.
        out: Folder for the results, or None for `./<job>-stability`.
        force: True to replace results that are there.
        progress: Display of the progress.
        allow_outside: True if the job may name files outside its folder.
    """
    folder = pathlib.Path(f"{file.stem}-stability") if out is None else out
    is_range = len(speeds) == 2 and 0 < speeds[0] < speeds[1] < math.inf
    if speeds and not is_range:
        found = " ".join(f"{speed:g}" for speed in speeds)
        raise BadInput(
            f"--speeds: found {found}, but two speeds above 0 rpm are required, the "
            "lower one first"
        )
    with bad_input():
        ResultsFolder.of(folder).check(force=force)
    # Imports that take seconds wait until they are needed.
    from .._result import SimulationFailed
    from .._toml import JobError
    from ..config import job_precision, load_job

    with bad_input():
        configure_jax(job_precision(file))
        with progress:
            progress.begin("reading the job")
            job = load_job(file, allow_outside=allow_outside)
        if job.is_rigid or not job.simulation.mode.vibrates:
            found = "[robot] rigid" if job.is_rigid else "[simulation] mode"
            raise JobError(
                file,
                [
                    f"{found}: found a machine that does not vibrate, but stability "
                    "needs one that does"
                ],
            )
    with locked_folder(folder) as unlocked:
        for note in (*job.notes, *filter(None, [unlocked])):
            progress.write(f"note: {note}")
        with interruption_leaves(lambda: "no results were written"):
            try:
                with progress:
                    lobes = _lobes(job, speeds, progress)
            except SimulationFailed as failure:
                message = f"error: the run failed: {failure}"
                print(printable(message), file=sys.stderr)
                return 1
        lines = lobes_lines(lobes)
        for line in lines:
            progress.answer(line)
        from ..io import write_results
        from ..viz import plot_lobes, save_figure

        dataset = lobes.to_dataset()
        text = "\n".join(lines) + "\n"
        write_results(
            folder, with_job(dataset, job), files={"summary.txt": text}, force=force
        )
        attempts = Attempts()

        def draw(target: pathlib.Path) -> None:
            with attempts.at("figure"):
                save_figure(plot_lobes(dataset), target / "lobes.png")

        with progress:
            progress.begin("figure")
            attempts.add(folder, draw)
        progress.write(f"results: {folder}")
        return attempts.conclude(folder)


def _lobes(
    job: "Job", speeds: tuple[float, ...], progress: Progress
) -> "StabilityLobes":
    """Lobes at the deepest places of a job's program.

    Raises:
        BadInput: The tool never cuts.
        SimulationFailed: The run fails.
    """
    from ..sim import simulate, stability_lobes

    solution = simulate(job, on_progress=progress.update)
    solution.raise_unless_successful(job)
    if not np.asarray(solution.is_cutting).any():
        raise BadInput(f"{job.name}: the tool never cuts, so no depth has a limit")
    progress.update("the deepest places of the program")
    grid = None
    if speeds:
        grid = np.linspace(_RPM * speeds[0], _RPM * speeds[1], _SPEEDS)
    return stability_lobes(job, solution, speeds=grid, on_progress=progress.stage)


def lobes_lines(lobes: "StabilityLobes") -> list[str]:
    """Lines on the limits of a program and the speeds to prefer.

    Args:
        lobes: The lobes.
    """
    own, deepest = lobes.own_speed / _RPM, 1e3 * lobes.deepest
    lines = [f"depth of cut at {own:.0f} rpm, and the limit there [mm]:"]
    at = lobes.own_column
    frequency = lobes.frequency[:, at]
    for k, limit in enumerate(lobes.limit[:, at]):
        x, y, z = 1e3 * lobes.position[k]
        depth = 1e3 * lobes.depth[k]
        verdict = "stable" if limit > lobes.depth[k] else "CHATTER"
        if math.isfinite(limit):
            verdict += f", a vibration at {frequency[k]:.1f} Hz grows beyond the limit"
        lines.append(
            f"  at ({x:.1f}, {y:.1f}, {z:.1f}) mm:{depth:8.3g}"
            f"{_depth(limit, deepest):>10}  {verdict}"
        )
    lines += ["", f"  {'speeds to prefer [rpm]':24}{'depth over the program':>24}"]
    for k in lobes.preferred():
        share = lobes.least[k]
        text = f"{share:.2f}" if math.isfinite(share) else "no limit found"
        lines.append(f"  {lobes.speed[k] / _RPM:<24.0f}{text:>24}")
    lines += ["", f"depths up to {deepest:.3g} mm were tried; {_ASSUMED}"]
    return lines


def _depth(limit: float, deepest: float) -> str:
    """Limit of a depth in words [mm]."""
    return f"{1e3 * limit:.3g}" if math.isfinite(limit) else f"> {deepest:.3g}"
