"""Running a job and writing its folder of results."""

import contextlib
import dataclasses
import importlib
import json
import math
import pathlib
import sys
import threading
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from .._jax_config import configure_jax, give_back_memory
from .._messages import printable
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
    interruption_leaves,
    locked_folder,
)
from ._session.progress import Progress

if TYPE_CHECKING:
    from .._job import Job
    from .._result import SimulationFailed
    from ..config import JobProgram
    from ..sim import Stability

# xarray and the parts that compute are imported when a job runs.
Dataset: TypeAlias = Any
Outcome: TypeAlias = Any

# The slowest imports of results, surfaces and figures.
_LATE_IMPORTS = (
    "xarray",
    "h5netcdf",
    "matplotlib.figure",
    "matplotlib.backends.backend_agg",
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
        force: True to replace results that are there.
        progress: Display of the progress.
        allow_outside: True if the job may name files outside its folder.
        tolerance_band: Contour error to hold the result against, with its unit; by
            default that of the job.
        resume: True to go on from the checkpoint of an interrupted run.
    """
    band, is_correction = _length(tolerance_band), command == "correct"
    folder = pathlib.Path(f"{file.stem}-{command}") if out is None else out
    with bad_input():
        results = ResultsFolder.of(folder)
        # A run that was interrupted after its results goes on into the same folder.
        may_replace = force or (resume and results.has_unfinished_run())
        results.check(force=may_replace)
    # Imports that take seconds wait until they are needed.
    from .._toml import JobError
    from ..config import JobProgram, job_precision, load_job

    # Compiled code leaves the interpreter free to import what comes later.
    importing = threading.Thread(target=_import_later, daemon=True)
    importing.start()
    with interruption_leaves(lambda: _earlier_files(results)), bad_input():
        uncached = configure_jax(job_precision(file))
        with progress:
            progress.begin("reading the job")
            job = load_job(file, allow_outside=allow_outside)
        if is_correction:
            job = with_resolution_note(job)
        if is_correction and job.is_rigid:
            raise JobError(
                file,
                [
                    "[robot] rigid: found true, but correct needs a robot, by model or "
                    "file, or [machine]"
                ],
            )
        if is_correction and job.commanded is not None:
            raise JobError(file, [ONLY_SIMULATE])
        # G-code as it is written cannot state how the tool tilts.
        has_gcode = ".ngc" in job.output.suffixes
        if is_correction and has_gcode and not job.path.is_upright:
            raise JobError(file, [NO_TILT])
    with locked_folder(folder) as unlocked:
        run = JobRun(is_correction, job, folder, may_replace, progress)
        with interruption_leaves(lambda: _earlier_files(results)), bad_input():
            if is_correction and job.output.moved_ends:
                run.program = JobProgram.of_job(file, allow_outside=allow_outside)
            run.checkpoint = Checkpoint(command, folder, job, progress)
            run.checkpoint.open(resume=resume, force=force)
        for note in (*job.notes, *filter(None, [uncached, unlocked])):
            progress.write(f"note: {note}")
        with interruption_leaves(run.interruption_text):
            return run.finish(band, importing)


def with_resolution_note(job: "Job") -> "Job":
    """Job for a correction, whose notes tell that it reuses no engagement."""
    if job.simulation.resolution != "adaptive":
        return job
    note = (
        '[simulation] resolution: found "adaptive", which holds in simulate; the '
        "engagement is updated in every tooth period in `correct`"
    )
    return dataclasses.replace(job, notes=(*job.notes, note))


class JobRun:
    """A run of a job whose folder is locked.

    Attributes:
        checkpoint: The checkpoint of a run that is to `finish`.
        program: The job's program before it was timed, where its block ends are moved.
    """

    checkpoint: Checkpoint | None = None
    program: "JobProgram | None" = None

    def __init__(
        self,
        is_correction: bool,
        job: "Job",
        folder: pathlib.Path,
        may_replace: bool,
        progress: Progress,
    ):
        self._is_correction, self._job, self._progress = is_correction, job, progress
        self._folder, self._may_replace = folder, may_replace
        self._is_written = False
        self._chatter: Stability | None = None

    def interruption_text(self) -> str:
        """Sentence on the files that an interruption leaves."""
        resumes = ""
        checkpoint = self.checkpoint
        if checkpoint is not None and checkpoint.file.exists():
            resumes = "the same command with --resume goes on from there"
        if self._is_written:
            more = f"; {resumes}" if resumes else ""
            return f"{self._folder} has the results without figures and report{more}"
        if checkpoint is not None:
            return checkpoint.interruption_text()
        return "no results were written"

    def finish(self, band: float | None, importing: threading.Thread) -> int:
        """Run the job, write its results and figures; return the exit code."""
        from .._padding import LONGEST
        from .._result import SimulationFailed
        from ..numerics import CachedJit
        from ..viz import summary

        checkpoint, start = self.checkpoint, time.perf_counter()
        assert checkpoint is not None
        try:
            with self._progress:
                outcome = _compute(
                    self._is_correction,
                    self._job,
                    self._progress,
                    checkpoint,
                    self._tell_chatter,
                )
        except SimulationFailed as failure:
            # The run would end alike from there.
            checkpoint.remove_own()
            return _write_failure(
                self._folder, self._job, failure, force=self._may_replace
            )
        except BadInput:
            # Of no use to the job as it will be, and in its way.
            checkpoint.remove_own()
            raise
        seconds = time.perf_counter() - start
        importing.join()
        if self._job.path.step_count > LONGEST:
            # Figures read one of these programs again, of the rigid cut.
            CachedJit.forget_all()
        # Programs took more while they were made than results and figures take.
        give_back_memory()
        seconds += checkpoint.spent
        run = self.write(outcome, band, seconds)
        # The verdict follows the analyses that it includes.
        self._progress.answer(summary(run.dataset, "figures"))
        self._progress.write(
            f"results: {self._folder}; the run took {seconds:.1f} s with compilation"
        )
        start = time.perf_counter()
        code = add_analyses(self._folder, run, self._progress)
        seconds = time.perf_counter() - start
        self._progress.write(
            f"analyses, figures and report took another {seconds:.1f} s"
        )
        checkpoint.remove()
        if self._progress.prints_json:
            figures = _figures(run.dataset, self._folder, run.job.notes)
            print(json.dumps(figures, indent=2))
        return code

    def _tell_chatter(self, before: Outcome) -> None:
        """Print chatter of the uncorrected path, before it is corrected."""
        self._chatter = _chatter(self._job, before, self._progress)

    def write(
        self, outcome: Outcome, band: float | None, seconds: float
    ) -> FinishedRun:
        """Write what was computed."""
        from ..io import write_results

        progress, is_correction = self._progress, self._is_correction
        solutions = outcome.cases if is_correction else {"predicted": outcome}
        final = outcome.after if is_correction else outcome
        job = self._job.with_intervals(final.stock.interval_counts)
        for note in job.notes[len(self._job.notes) :]:
            progress.write(f"note: {note}")
        surfaces, left_out, files = None, "", {}
        if not is_correction:
            dataset = with_job(outcome.to_dataset(), job)
        else:
            with progress:
                progress.begin("the machined surfaces")
                try:
                    surfaces = outcome.surfaces()
                except ValueError as error:
                    # A mesh can be too large for the memory where its stock was not.
                    surfaces, left_out = {}, str(error)
            dataset = with_job(outcome.to_dataset(surfaces), job)
            if left_out:
                dataset.attrs["surface_left_out"] = left_out
                progress.write(f"warning: without the error of the surface: {left_out}")
            from ._written.corrected import corrected_files
            from ._written.moved_ends import moved_files

            commanded = np.asarray(outcome.commanded, float)
            files, lines = corrected_files(job, commanded)
            if job.output.moved_ends:
                moved, moved_lines = moved_files(job, self.program, commanded)
                files, lines = files | moved, [*lines, *moved_lines]
            for line in lines:
                progress.write(line)
        band = float(job.correction.tolerance_band) if band is None else band
        dataset.attrs["tolerance_band"] = band
        dataset.attrs.setdefault("wall_time_s", seconds)
        # Whatever fails from here on, the run is kept.
        force = self._may_replace
        self._folder = ResultsFolder.of(self._folder).still_free(force=force)
        results = ResultsFolder.of(self._folder)
        before = results.version
        try:
            write_results(
                self._folder, dataset, files=files, stock=final.stock, force=force
            )
        finally:
            # An interruption while files get their names is raised behind that.
            self._is_written = results.version not in (None, before)
        return FinishedRun(
            job, solutions, final, dataset, self.program, surfaces, self._chatter
        )


def _chatter(job: "Job", before: Outcome, progress: Progress) -> "Stability | None":
    """Chatter of the uncorrected path, which is printed before it is corrected."""
    try:
        growth = job_stability(job, before)
    except Exception as error:
        # The analyses after the run try it again and report a failure.
        progress.write(f"warning: stability before the correction failed: {error}")
        return None
    if growth is None or growth.warning() is None:
        return None
    for line in stability_lines(growth):
        progress.write(line)
    return growth


def _earlier_files(results: ResultsFolder) -> str:
    """Sentence on the files that an interruption leaves before the computation."""
    folder = [results.path] if results.path.exists() else []
    earlier = " and ".join(map(str, [*folder, *results.checkpoints()]))
    remains = f"; what an earlier run left is as it was: {earlier}" if earlier else ""
    return f"no results were written{remains}"


def _import_later() -> None:
    """Import modules of later steps, where a failure comes again and is reported."""
    with contextlib.suppress(Exception):
        for name in _LATE_IMPORTS:
            importlib.import_module(name)


def _length(text: str | None) -> float | None:
    """Length of the command line [m]."""
    from ..units import LENGTH, quantity

    if text is None:
        return None
    try:
        length = quantity(text, LENGTH)
    except ValueError:
        length = 0.0
    if length > 0:
        return length
    raise BadInput(
        f"--tolerance-band: found {text!r}, but a length above 0 with its unit is "
        'required, such as "20 um"'
    )


def _figures(
    dataset: Dataset, folder: pathlib.Path, notes: tuple[str, ...]
) -> dict[str, Any]:
    """Headline figures of all cases in SI, as JSON; None where there is none."""
    from ..viz import case_numbers

    cases = dataset["case"].values.tolist() if "case" in dataset.dims else ["predicted"]
    numbers = {}
    for name in cases:
        case = case_numbers(dataset, name)
        figures = {
            "rms": case.contour.rms,
            "percentile_95": case.contour.p95,
            "maximum": case.contour.max,
            "deviation_rms": case.deviation_rms,
            "force_mean": case.force_mean,
            "force_maximum": case.force_maximum,
            "power_maximum": case.power_maximum,
            "removed_volume": case.removed_volume,
        }
        known = {k: v if math.isfinite(v) else None for k, v in figures.items()}
        numbers[name] = {"name": name, **known}
    return {
        "job": dataset.attrs["job"],
        "results": str(folder),
        "wall_time_s": dataset.attrs["wall_time_s"],
        "cases": numbers,
        "notes": list(notes),
    }


def _compute(
    is_correction: bool,
    job: "Job",
    progress: Progress,
    checkpoint: Checkpoint,
    on_predicted: Callable[[Outcome], None],
) -> Outcome:
    """Run the job; `on_predicted` is called before anything is corrected."""
    from ..sim import simulate

    def write_checkpoint(arrays: Mapping[str, np.ndarray]) -> None:
        checkpoint.write(arrays)
        # What the programs of the first segment took while they were made is free.
        give_back_memory()

    if not is_correction:
        return simulate(
            job,
            on_progress=progress.update,
            on_checkpoint=write_checkpoint,
            resume=checkpoint.resumed,
        )
    from ..correction import correct

    def tell(message: str, rms: float) -> None:
        text = f"{message}: weighted error {rms * 1e6:.2f} um rms"
        progress.update(text, then=f"after {message}")

    def tell_run(message: str, share: float) -> None:
        progress.update(f"uncorrected path: {message}", share)

    with bad_correction(job.name, "to correct"):
        return correct(
            job,
            on_predicted=on_predicted,
            on_progress=tell,
            on_run_progress=tell_run,
            on_step_progress=progress.within,
            on_checkpoint=write_checkpoint,
            resume=checkpoint.resumed,
        )


def with_job(dataset: Dataset, job: "Job") -> Dataset:
    """Dataset whose attributes hold the job's name, text and notes."""
    added: dict[str, Any] = {
        "job": job.name,
        "spindle_speed": float(job.spindle_speed),
        "source": job.source,
        "program": job.program,
    }
    if job.commanded is not None:
        added["is_commanded"] = 1
    if job.notes:
        added["notes"] = "\n".join(job.notes)
    dataset.attrs = {**added, **dataset.attrs}
    return dataset


def _write_failure(
    folder: pathlib.Path, job: "Job", failure: "SimulationFailed", *, force: bool
) -> int:
    """Write the results of an aborted run; return the exit code 1."""
    from ..io import mark_incomplete, write_results

    print(printable(f"error: the run failed: {failure}"), file=sys.stderr)
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
