"""Running a job and writing its folder of results."""

import pathlib
import sys
import time
from typing import TYPE_CHECKING, Any, TypeAlias

import equinox as eqx
import numpy as np

from ._figures import write_pictures
from ._session.checkpoint import Checkpoint
from ._session.errors import BadInput, bad_input
from ._session.jax_config import configure_jax
from ._session.progress import Progress

if TYPE_CHECKING:
    from .._job import Job
    from .._result import SimulationFailed

# xarray and the parts that compute are imported when a job runs.
Dataset: TypeAlias = Any
Outcome: TypeAlias = Any


def run_job(
    command: str,
    file: pathlib.Path,
    out: pathlib.Path | None,
    *,
    force: bool,
    is_quiet: bool,
    allow_outside: bool,
    resume: bool = False,
) -> int:
    """Load, run and write a job; return the exit code.

    Args:
        command: "simulate" or "correct".
        file: The job file.
        out: Folder for the results, or None for `./<job>-<command>`.
        force: Whether results that are there are replaced.
        is_quiet: Whether only errors are printed.
        allow_outside: Whether the job may name files outside its folder.
        resume: Whether a correction goes on from its checkpoint.
    """
    from .._result import SimulationFailed
    from ..config import JobError, load_job
    from ..io import check_folder
    from ..sim import with_intervals_of

    folder = pathlib.Path(f"{file.stem}-{command}") if out is None else out
    with bad_input():
        check_folder(folder, force=force)
        configure_jax(file)
        job = load_job(file, allow_outside=allow_outside)
        if command == "correct" and job.robot is None:
            raise JobError(
                file,
                ["[robot] rigid: found true, but correct needs a robot: model or file"],
            )
    progress = Progress(is_quiet=is_quiet)
    checkpoint = None
    if command == "correct":
        with bad_input():
            checkpoint = Checkpoint(folder, job)
            checkpoint.open(resume=resume, force=force, progress=progress)
    told = len(job.notes)
    for note in job.notes:
        progress.say(f"note: {note}")
    start = time.perf_counter()
    try:
        with progress:
            outcome = _compute(command, job, progress, checkpoint)
    except SimulationFailed as failure:
        return _keep_failure(folder, job, failure, force=force)
    seconds = time.perf_counter() - start
    final = outcome if command == "simulate" else outcome.after
    job = with_intervals_of(job, final.stock)
    for note in job.notes[told:]:
        progress.say(f"note: {note}")
    dataset = with_job(outcome.to_dataset(), job)
    dataset.attrs.setdefault("wall_time_s", seconds)
    dataset = _with_contacts(job, final, dataset, progress)
    if np.asarray(final.is_cutting).any():
        _tell_stability(job, final, dataset, progress)
    if job.simulation.has_sensitivity:
        progress.say("sensitivity: one derivative for each parameter")
        dataset = _with_sensitivity(job, final, dataset)
    _write(command, folder, job, outcome, dataset, force=force)
    if checkpoint is not None:
        checkpoint.remove()
    progress.say(_summary(dataset, job))
    if dataset.attrs.get("corrected_outcome") == "steps ran out":
        progress.say(
            "note: the optimiser ended after [correction] max_steps, before it "
            "settled: more steps may gain more"
        )
    progress.say(f"results: {folder} ({seconds:.1f} s)")
    return 0


def _compute(
    command: str, job: "Job", progress: Progress, checkpoint: Checkpoint | None
) -> Outcome:
    """Run the job."""
    if command == "simulate":
        from ..sim import simulate

        return simulate(job, on_progress=progress.update)
    from ..correction import (
        InfeasibleLimit,
        NothingToCorrect,
        UnsuitableSettings,
        correct,
    )

    def tell(message: str, rms: float) -> None:
        progress.update(f"{message}: contour error {rms * 1e6:.2f} um rms")

    try:
        return correct(
            job,
            on_progress=tell,
            on_checkpoint=None if checkpoint is None else checkpoint.write,
            resume=None if checkpoint is None else checkpoint.resumed,
        )
    except (InfeasibleLimit, UnsuitableSettings) as error:
        raise BadInput(f"{job.name}: [correction] {error}") from error
    except NothingToCorrect as error:
        raise BadInput(
            f"{job.name}: found nothing to correct: {error} Check the stock's place, "
            "the program's zero and [correction] weight."
        ) from error


def _with_sensitivity(job: "Job", solution: Outcome, dataset: Dataset) -> Dataset:
    """Return the dataset with the sensitivity of a solution's command."""
    from ..sim import sensitivity

    maps = sensitivity(job, commanded=np.asarray(solution.commanded))
    return dataset.assign(maps.to_dataset().data_vars)


def _with_contacts(
    job: "Job", solution: Outcome, dataset: Dataset, progress: Progress
) -> Dataset:
    """Return the dataset with the holder's contacts; say where it and the shank are."""
    from ..config import holder_notes, shank_notes
    from ..sim import tool_contacts

    lines = shank_notes(job.path, np.asarray(solution.shank_volume))
    if job.holder is not None:
        contacts = tool_contacts(
            job.path,
            job.stock,
            job.cutter,
            job.holder,
            positions=np.asarray(solution.actual),
            checks_rapids=False,
        )
        dataset = dataset.assign(contacts.to_dataset().data_vars)
        lines += holder_notes(job.path, contacts)
    _say_and_keep([f"warning: {line}" for line in lines], dataset, progress)
    return dataset


def _say_and_keep(lines: list[str], dataset: Dataset, progress: Progress) -> None:
    """Say lines and add them to the notes in the attributes of a dataset."""
    for line in lines:
        progress.say(line)
    notes = [dataset.attrs["notes"]] if "notes" in dataset.attrs else []
    if lines:
        dataset.attrs["notes"] = "\n".join([*notes, *lines])


def _tell_stability(
    job: "Job", solution: Outcome, dataset: Dataset, progress: Progress
) -> None:
    """Look for chatter, say what is found and keep it in the attributes."""
    from ..sim import find_chatter, stability

    check = job.simulation.stability
    if check == "none":
        return
    found = (find_chatter if check == "quick" else stability)(job, solution)
    if found is None:
        return
    warning = found.warning()
    lines = [
        f"warning: {warning}"
        if warning
        else f"stability: of {len(found.row)} rows none is unstable; the fastest "
        f"growing vibration has the factor {found.radius.max():.3f} per tooth period",
        f"stability: {found.visibility()}",
    ]
    if check == "quick":
        lines.append(
            "stability: looked at where the cut is deepest; [simulation] "
            "stability = true looks along the whole path"
        )
    _say_and_keep(lines, dataset, progress)
    dataset.attrs["stability_largest_radius"] = float(found.radius.max())


def with_job(dataset: Dataset, job: "Job") -> Dataset:
    """Return a dataset whose attributes hold the job's name, text and notes."""
    added = {"job": job.name, "source": job.source, "program": job.program}
    if job.notes:
        added["notes"] = "\n".join(job.notes)
    dataset.attrs = {**added, **dataset.attrs}
    return dataset


def _write(
    command: str,
    folder: pathlib.Path,
    job: "Job",
    outcome: Outcome,
    dataset: Dataset,
    *,
    force: bool,
) -> None:
    """Write a finished run."""
    from ..io import described, write_results

    dataset = described(dataset)
    files: dict[str, str] = {}
    final = outcome
    solutions = {"predicted": outcome}
    if command == "correct":
        final = outcome.after
        solutions = outcome.cases
        files.update(_corrected_files(job, outcome))
    write_results(
        folder,
        dataset,
        files=files,
        fill=lambda target: write_pictures(target, job, solutions, dataset),
        stock=final.stock,
        force=force,
    )


def _corrected_files(job: "Job", correction: Outcome) -> dict[str, str]:
    """Return the corrected path and program, by file name."""
    from ..io import write_gcode, write_path_csv

    path = eqx.tree_at(
        lambda p: p.positions, job.path, np.asarray(correction.commanded, float)
    )
    header = [f"{job.name}, corrected by diffmill", f"method: {job.correction.method}"]
    program = write_gcode(path, header=header, spindle_speed=float(job.spindle_speed))
    return {"corrected.csv": write_path_csv(path), "corrected.ngc": program}


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
    write_results(folder, dataset, stock=solution.stock, force=force)
    print(
        f"what was computed before is in {folder}, marked incomplete", file=sys.stderr
    )
    return 1


def _summary(dataset: Dataset, job: "Job") -> str:
    """Return the headline figures as a small table."""
    from ..viz import case_numbers

    cases = ["predicted"]
    if "case" in dataset.dims:
        cases = [str(name) for name in dataset["case"].values]
    rows = [f"{job.name}: contour error where the tool cuts [um], force [N]"]
    rows.append(f"{'case':16}{'rms':>10}{'95 %':>10}{'max':>10}{'mean force':>12}")
    for case in cases:
        found = case_numbers(dataset, case)
        errors = (found.rms, found.percentile_95, found.maximum)
        numbers = "".join(f"{value * 1e6:10.2f}" for value in errors)
        rows.append(f"{case:16}{numbers}{found.force_mean:12.2f}")
    return "\n".join([*rows, *_parts(dataset)])


def _parts(dataset: Dataset) -> list[str]:
    """Return lines of the mean, the parts of the path and the price of each case."""
    from ..viz import case_parts

    cases = case_parts(dataset)
    if not cases:
        return []
    parts = [part for part, rows in cases[0].rows.items() if rows]
    head = "".join(f"{part:>10}" for part in parts)
    rows = [
        "",
        "mean vector and rms by part of the path [um], largest acceleration of the "
        "command [m/s^2], simulations",
        f"{'case':16}{'mean x':>9}{'y':>9}{'z':>9}{head}{'accel.':>8}{'runs':>6}"
        f"{'time':>9}",
    ]
    for case in cases:
        mean = "".join(f"{1e6 * value:9.2f}" for value in case.mean)
        rms = "".join(f"{1e6 * case.rms[part]:10.2f}" for part in parts)
        rows.append(
            f"{case.name:16}{mean}{rms}{case.max_acceleration:8.2f}"
            f"{case.forward_runs:6d}{case.seconds:7.1f} s"
        )
    rows += [
        f"warning: {case.name}: the tool leaves the cut in {case.rows_out_of_cut} "
        "steps where it should be in a full cut"
        for case in cases
        if case.rows_out_of_cut
    ]
    return rows
