"""Running a job and writing its folder of results."""

import contextlib
import importlib
import json
import math
import pathlib
import sys
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from .._jax_config import configure_jax
from .._results_folder import ResultsFolder
from ._analyses import (
    FinishedRun,
    add_analyses,
    job_stability,
    stability_lines,
)
from ._session.checkpoint import Checkpoint
from ._session.errors import (
    NO_TILT,
    ONLY_SIMULATE,
    BadInput,
    bad_correction,
    bad_input,
)
from ._session.memory import give_back_memory
from ._session.progress import Progress

if TYPE_CHECKING:
    from .._job import Job
    from .._result import SimulationFailed
    from ..sim import Stability

# xarray and the parts that compute are imported when a job runs.
Dataset: TypeAlias = Any
Outcome: TypeAlias = Any

# What takes longest to import of what results, surfaces and figures need.
_LATER = (
    "xarray",
    "h5netcdf",
    "matplotlib.figure",
    "matplotlib.backends.backend_agg",
    "scipy.signal",
    "scipy.spatial",
)


def run_job(
    command: str,
    file: pathlib.Path,
    out: pathlib.Path | None,
    *,
    force: bool,
    progress: Progress,
    allow_outside: bool,
    tolerance_band: str | None = None,
    resume: bool = False,
) -> int:
    """Load, run and write a job; return the exit code.

    Args:
        command: "simulate" or "correct".
        file: The job file.
        out: Folder for the results, or None for `./<job>-<command>`.
        force: Whether results that are there are replaced.
        progress: Shows how far it is.
        allow_outside: Whether the job may name files outside its folder.
        tolerance_band: Contour error to hold the result against, with its unit; by
            default that of the job.
        resume: Whether a correction goes on from its checkpoint.
    """
    band = _length(tolerance_band)
    folder = pathlib.Path(f"{file.stem}-{command}") if out is None else out
    with bad_input():
        ResultsFolder.of(folder).check(force=force)
    # What takes seconds to import waits until it is needed.
    from .._result import SimulationFailed
    from .._toml import JobError
    from ..config import JobProgram, job_precision, load_job
    from ..io import write_results

    # Compiled code leaves the interpreter free to import what comes later.
    importing = threading.Thread(target=_import_later, daemon=True)
    importing.start()
    with bad_input():
        uncached = configure_jax(job_precision(file))
        with progress:
            progress.begin("reading the job")
            job = load_job(file, allow_outside=allow_outside)
        if command == "correct" and job.is_rigid:
            raise JobError(
                file,
                [
                    "[robot] rigid: found true, but correct needs a robot, by model or "
                    "file, or [machine]"
                ],
            )
        if command == "correct" and job.commanded is not None:
            raise JobError(file, [ONLY_SIMULATE])
        if command == "correct" and not _can_be_written(job):
            raise JobError(file, [NO_TILT])
    checkpoint = program = None
    if command == "correct":
        with bad_input():
            if job.output.moves_ends:
                program = JobProgram.of_job(file, allow_outside=allow_outside)
            checkpoint = Checkpoint(folder, job)
            checkpoint.open(resume=resume, force=force, progress=progress)
    told = len(job.notes)
    for note in (*job.notes, *filter(None, [uncached])):
        progress.say(f"note: {note}")
    start = time.perf_counter()
    chatter: list[Stability] = []

    def tell_chatter(before: Outcome) -> None:
        if found := _chatter(job, before, progress):
            chatter.append(found)

    try:
        with progress:
            outcome = _compute(command, job, progress, checkpoint, tell_chatter)
    except SimulationFailed as failure:
        return _keep_failure(folder, job, failure, force=force)
    except BadInput:
        # Of no use to the job as it will be, and in its way.
        if checkpoint is not None and checkpoint.is_ours:
            checkpoint.remove()
        raise
    except KeyboardInterrupt:
        if checkpoint is None or not checkpoint.file.exists():
            raise
        print(
            f"error: interrupted; no results were written, but {checkpoint.file.path} "
            "keeps what was found: the same command with --resume goes on from there",
            file=sys.stderr,
        )
        return 1
    seconds = time.perf_counter() - start
    importing.join()
    # What programs took while they were made is more than results and figures take.
    give_back_memory()
    if checkpoint is not None:
        seconds += checkpoint.spent
    solutions = {"predicted": outcome} if command == "simulate" else outcome.cases
    final = outcome if command == "simulate" else outcome.after
    job = job.with_intervals(final.stock.interval_counts)
    for note in job.notes[told:]:
        progress.say(f"note: {note}")
    surfaces = None
    if command == "simulate":
        dataset = with_job(outcome.to_dataset(), job)
    else:
        surfaces, left_out = _surfaces(outcome)
        dataset = with_job(outcome.to_dataset(surfaces), job)
        if left_out:
            dataset.attrs["surface_left_out"] = left_out
            progress.say(f"warning: without the error of the surface: {left_out}")
    band = float(job.correction.tolerance_band) if band is None else band
    dataset.attrs["tolerance_band"] = band
    dataset.attrs.setdefault("wall_time_s", seconds)
    files = {}
    if command == "correct":
        from ._written.corrected import corrected_files
        from ._written.moved_ends import moved_files

        commanded = np.asarray(outcome.commanded, float)
        files, said = corrected_files(job, commanded)
        if job.output.moves_ends:
            more, lines = moved_files(job, program, commanded)
            files, said = files | more, [*said, *lines]
        for line in said:
            progress.say(line)
    # Whatever fails from here on, the run is kept.
    folder = ResultsFolder.of(folder).still_free(force=force)
    write_results(folder, dataset, files=files, stock=final.stock, force=force)
    if checkpoint is not None:
        checkpoint.remove()
    progress.answer(_summary(dataset))
    progress.say(f"results: {folder}; the run took {seconds:.1f} s with compilation")
    run = FinishedRun(job, solutions, final, dataset, program, surfaces, *chatter)
    code = _analyse(folder, run, progress)
    if progress.prints_json:
        print(json.dumps(_figures(dataset, folder, job.notes), indent=2))
    return code


def _chatter(job: "Job", before: Outcome, progress: Progress) -> "Stability | None":
    """Return the chatter of the uncorrected path, and say it before it is corrected."""
    try:
        found = job_stability(job, before)
    except Exception as error:
        # The analyses after the run try it again and keep what fails.
        progress.say(f"warning: stability before the correction failed: {error}")
        return None
    if found is None or found.warning() is None:
        return None
    for line in stability_lines(found):
        progress.say(line)
    return found


def _surfaces(outcome: Outcome) -> tuple[dict[str, Any], str]:
    """Return the surface errors of a correction, or none and why.

    A mesh of the surface can be too large for the memory where its stock was not.
    """
    try:
        return outcome.surfaces(), ""
    except ValueError as error:
        return {}, str(error)


def _can_be_written(job: "Job") -> bool:
    """Return whether the formats of a corrected program can say how the tool tilts."""
    return job.path.is_upright or ".ngc" not in job.output.formats


def _import_later() -> None:
    """Import what comes later; what fails here fails again, and is told, there."""
    with contextlib.suppress(Exception):
        for name in _LATER:
            importlib.import_module(name)


def _length(text: str | None) -> float | None:
    """Return a length of the command line [m]."""
    from ..units import LENGTH, quantity

    if text is None:
        return None
    try:
        found = quantity(text, LENGTH)
    except ValueError:
        found = 0.0
    if found > 0:
        return found
    raise BadInput(
        f"--tolerance-band: found {text!r}, but a length above 0 with its unit is "
        'required, such as "20 um"'
    )


def _analyse(folder: pathlib.Path, run: FinishedRun, progress: Progress) -> int:
    """Add analyses and figures to written results; return the exit code."""
    start = time.perf_counter()
    try:
        code = add_analyses(folder, run, progress)
    except KeyboardInterrupt:
        print(
            f"error: interrupted; {folder} has the results without figures and report",
            file=sys.stderr,
        )
        return 1
    seconds = time.perf_counter() - start
    progress.say(f"analyses, figures and report took another {seconds:.1f} s")
    return code


def _figures(
    dataset: Dataset, folder: pathlib.Path, notes: tuple[str, ...]
) -> dict[str, Any]:
    """Return the headline figures of all cases in SI; None where there is none."""
    from ..viz import case_numbers

    known = lambda x: None if isinstance(x, float) and not math.isfinite(x) else x
    cases = dataset["case"].values.tolist() if "case" in dataset.dims else ["predicted"]
    numbers = {
        name: {k: known(v) for k, v in vars(case_numbers(dataset, name)).items()}
        for name in cases
    }
    return {
        "job": dataset.attrs["job"],
        "results": str(folder),
        "wall_time_s": dataset.attrs["wall_time_s"],
        "cases": numbers,
        "notes": list(notes),
    }


def _summary(dataset: Dataset) -> str:
    """Return the headline figures; the verdict follows the analyses it tells of."""
    from ..viz import summary

    return summary(dataset, "figures")


def _compute(
    command: str,
    job: "Job",
    progress: Progress,
    checkpoint: Checkpoint | None,
    on_predicted: Callable[[Outcome], None],
) -> Outcome:
    """Run the job; `on_predicted` is called before anything is corrected."""
    from ..sim import simulate

    if command == "simulate":
        return simulate(job, on_progress=progress.update)
    from ..correction import correct

    def tell(message: str, rms: float) -> None:
        text = f"{message}: weighted error {rms * 1e6:.2f} um rms"
        progress.update(text, then=f"after {message}")

    progress.update("uncorrected path")
    with bad_correction(job.name, "to correct"):
        return correct(
            job,
            on_predicted=on_predicted,
            on_progress=tell,
            on_checkpoint=None if checkpoint is None else checkpoint.write,
            resume=None if checkpoint is None else checkpoint.resumed,
        )


def with_job(dataset: Dataset, job: "Job") -> Dataset:
    """Return a dataset whose attributes hold the job's name, text and notes."""
    added: dict[str, Any] = {
        "job": job.name,
        "source": job.source,
        "program": job.program,
    }
    if job.commanded is not None:
        added["is_commanded"] = 1
    if job.notes:
        added["notes"] = "\n".join(job.notes)
    dataset.attrs = {**added, **dataset.attrs}
    return dataset


def _keep_failure(
    folder: pathlib.Path, job: "Job", failure: "SimulationFailed", *, force: bool
) -> int:
    """Keep what an aborted run has computed; return the exit code 1."""
    from ..io import mark_incomplete, write_results

    print(f"error: the run failed: {failure}", file=sys.stderr)
    solution: Any = failure.solution
    if solution is None:
        print("nothing could be kept", file=sys.stderr)
        return 1
    failed = np.asarray(solution.has_failed) | ~np.asarray(solution.is_reached)
    step = int(np.argmax(failed)) if failed.any() else None
    dataset = with_job(solution.to_dataset(), job)
    dataset = mark_incomplete(dataset, str(failure), failed_step=step)
    folder = ResultsFolder.of(folder).still_free(force=force)
    write_results(folder, dataset, stock=solution.stock, force=force)
    print(
        f"what was computed before is in {folder}, marked incomplete", file=sys.stderr
    )
    return 1
