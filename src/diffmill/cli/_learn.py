"""Learning from measured parts: what was found, the next program, files and report."""

import dataclasses
import pathlib
import sys
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from .._jax_config import configure_jax
from .._messages import printable
from .._results_folder import ResultsFolder, netcdf_bytes
from .._toml import read_toml
from ._analyses import add_analyses
from ._run_job import JobRun, with_resolution_note
from ._session.attempts import Attempts
from ._session.checkpoint import Checkpoint
from ._session.errors import (
    bad_correction,
    bad_input,
    interruption_leaves,
    locked_folder,
)
from ._session.progress import Progress

if TYPE_CHECKING:
    from ..config import MeasuredJob
    from ..learning import LearnedMachine


def run_learn(
    file: pathlib.Path,
    out: pathlib.Path | None,
    *,
    advises: bool,
    force: bool,
    progress: Progress,
    allow_outside: bool,
    resume: bool = False,
) -> int:
    """Learn from measured parts, write what was found and the next program.

    Args:
        file: The file that names job and measurements.
        out: Folder for the results, or None for `./<file>-learn` or -advise.
        advises: True to rank measurements instead of writing the next program.
        force: True to replace results that are there.
        progress: Display of the progress.
        allow_outside: True if the file may name files outside its folder.
        resume: True to go on from the checkpoint of an interrupted run.

    Returns:
        The exit code.
    """
    kind = "advise" if advises else "learn"
    folder = pathlib.Path(f"{file.stem}-{kind}") if out is None else out
    with bad_input():
        results = ResultsFolder.of(folder)
        # A run that was interrupted after its results goes on into the same folder.
        may_replace = force or (resume and results.has_unfinished_run())
        results.check(force=may_replace)
        job_file = file.parent / str(read_toml(file).tables.get("job", ""))
    from ..config import JobProgram, job_precision, load_learning

    program = None
    with interruption_leaves(lambda: "no results were written"), bad_input():
        uncached = configure_jax(job_precision(job_file))
        with progress:
            progress.begin("reading job and measurements")
            measured = load_learning(
                file, allow_outside=allow_outside, needs_parts=not advises
            )
        measured = measured._replace(job=with_resolution_note(measured.job))
        if advises:
            measured = measured._replace(steps=0)
        if measured.steps and measured.job.output.moved_ends:
            program = JobProgram.of_job(job_file, allow_outside=allow_outside)
    with locked_folder(folder) as unlocked:
        notes = (*measured.job.notes, *measured.notes, uncached, unlocked)
        for note in filter(None, notes):
            progress.write(f"note: {note}")
        if advises:
            with interruption_leaves(lambda: "no results were written"):
                return _advise(measured, folder, progress, force=force)
        checkpoint = Checkpoint("learn", folder, measured, progress)
        with bad_input():
            checkpoint.open(resume=resume, force=force)
        with interruption_leaves(checkpoint.interruption_text):
            start = time.perf_counter()
            found = _learnt(measured, progress, checkpoint)
            if found is None:
                return 1
        seconds = time.perf_counter() - start + checkpoint.spent
        lines = _lines(measured, found)
        for line in lines:
            progress.answer(line)
        fill = _filler(folder, file, measured, found, lines)
        if found.correction is None:
            results.write(fill, force=may_replace)
            code = _with_figures(folder, measured, found, progress)
            checkpoint.remove()
            return code
        # What is drawn about the model is no longer about this machine.
        truth = dataclasses.replace(found.job.truth, draws=0)
        job = dataclasses.replace(found.job, truth=truth)
        from ._pages.learning import learnt_report

        run = JobRun(True, job, folder, may_replace, progress)
        run.program, run.checkpoint = program, checkpoint
        with interruption_leaves(run.interruption_text):
            finished = run.write(found.correction, None, seconds)
            attempts = Attempts()
            attempts.add(folder, fill)
            notes = [finished.dataset.attrs.get("notes", ""), *lines]
            finished = finished._replace(
                dataset=finished.dataset.assign_attrs(
                    notes="\n".join(notes).strip(),
                    learnt_expected_rms=found.expected_rms(found.correction.after),
                ),
                draw=lambda target: _figures(target, found),
                study=learnt_report(measured, found, lines),
            )
            code = add_analyses(folder, finished, progress)
            progress.write(f"results: {folder}")
            code = code or attempts.conclude(folder)
            checkpoint.remove()
            return code


def _learnt(
    measured: "MeasuredJob", progress: Progress, checkpoint: Checkpoint | None = None
) -> "LearnedMachine | None":
    """Machine that was learnt; None if a run of it failed, which is printed."""
    from .._result import SimulationFailed
    from ..learning import learn

    try:
        with progress, bad_correction(measured.job.name, "to correct"):
            return learn(
                measured.job,
                measured.parts,
                prior=measured.prior,
                max_steps=measured.steps,
                on_progress=progress.stage,
                on_checkpoint=None if checkpoint is None else checkpoint.write,
                resume=None if checkpoint is None else checkpoint.resumed,
            )
    except SimulationFailed as failure:
        message = f"error: a part could not be simulated: {failure}"
        print(printable(message), file=sys.stderr)
        return None


def _advise(
    measured: "MeasuredJob",
    folder: pathlib.Path,
    progress: Progress,
    *,
    force: bool,
) -> int:
    """Rank measurements, write the ranking; return the exit code."""
    from .._result import SimulationFailed
    from ..learning import MachinePosterior, MachinePrior, advise

    job, known, lines = measured.job.with_precision(), measured.prior, []
    if isinstance(known, MachinePrior):
        known = MachinePosterior.of_prior(job, known)
    if measured.parts:
        found = _learnt(measured, progress)
        if found is None:
            return 1
        known, lines = found.posterior, [*_lines(measured, found), ""]
    try:
        with progress:
            ranked = advise(job, known, measured.trials, on_progress=progress.stage)
    except SimulationFailed as failure:
        print(printable(f"error: a trial cannot be run: {failure}"), file=sys.stderr)
        return 1
    lines.append("error across the path, rms, by parameters that stay unknown:")
    lines += [
        f"  {one.name or 'without another measurement':42}{1e6 * one.spread:8.2f} um"
        for one in ranked
    ]
    for line in lines:
        progress.answer(line)
    from ._pages.learning import advice_report

    page = advice_report(measured, ranked, lines)

    def fill(target: pathlib.Path) -> None:
        text = "\n".join(lines) + "\n"
        (target / "summary.txt").write_text(text, encoding="utf-8")
        page.write(target)

    ResultsFolder.of(folder).write(fill, force=force)
    progress.write(f"results: {folder}")
    return 0


def _lines(measured: "MeasuredJob", found: "LearnedMachine") -> list[str]:
    """Lines on what was learnt."""
    from ._pages.learning import OBSERVED, OPEN

    count = len(measured.parts)
    lines = [f"measured parts of {measured.job.name}: {count}", ""]
    lines.append("what they show, rms, and what is left of it:")
    lines.append(
        f"  {'':28}{'beyond model':>14}{'machine':>10}{'process':>10}{'noise':>8}"
    )
    for one in found.explained:
        what, scale, unit = OBSERVED[one.observed]
        name = f"{measured.part_names[one.part - 1]}, {what}"
        sizes = (one.beyond_model, one.beyond_machine, one.beyond_process, one.noise)
        model, machine, process, noise = (f"{scale * x:.3g}" for x in sizes)
        lines.append(
            f"  {name:28}{model:>14}{machine:>10}{process:>10}{noise:>8} {unit}"
        )
    if not found.is_known_better:
        lines += [
            "",
            "the parts show nothing that the model does not know: what they show is "
            f"exp({found.gain:.2g}) times as likely with another machine, exp(3) is "
            "asked for",
        ]
        return [*lines, *_next_lines(found)]
    from ..viz import CAUSES

    causes = sorted(found.causes().items(), key=lambda one: -one[1])
    lines += ["", "causes, across the path where the tool cuts, rms:"]
    lines += [f"  {CAUSES[name]:24}{1e6 * x:8.2f} um" for name, x in causes]
    lines += ["", f"  {'parameter':22}{'value':>10}{'std. error':>12}{'before':>10}"]
    values = found.values()
    lines += [_value_line(one) for one in values if one.open_share < OPEN]
    left = [one.name for one in values if one.open_share >= OPEN]
    if left:
        lines += ["", f"not told by these parts: {', '.join(left)}"]
    return [*lines, *_next_lines(found)]


def _value_line(one: "LearnedMachine.Value") -> str:
    """Line of a parameter, with its standard errors afterwards and before."""
    from ._pages.learning import SHOWN

    scale, unit = SHOWN.get(one.unit, (1.0, one.unit))
    value, error, size = (f"{scale * x:.3g}" for x in (one.value, one.error, one.size))
    return f"  {one.name:22}{value:>10}{error:>12}{size:>10} {unit}"


def _next_lines(found: "LearnedMachine") -> list[str]:
    """Lines on the commands that were cut, and the next one."""
    parts = ", ".join(f"{1e6 * x:.2f}" for x in found.part_errors)
    lines = ["", f"on this machine the commands that were cut leave {parts} um rms"]
    if found.correction is not None:
        after = found.correction.after
        own, expected = after.contour.rms, found.expected_rms(after)
        lines.append(
            f"the next one leaves {1e6 * own:.2f} um; {1e6 * expected:.2f} um are "
            "expected with what is not known of the machine"
        )
    return lines


def _filler(
    folder: pathlib.Path,
    file: pathlib.Path,
    measured: "MeasuredJob",
    found: "LearnedMachine",
    lines: list[str],
) -> Callable[[pathlib.Path], None]:
    """Writer of the files of what was learnt."""
    toml = [
        f"# learnt from {file.name} by diffmill: paste into a job of this machine",
        *(f"# {line}".rstrip() for line in lines),
        "[learnt]",
        f'file = "{folder.name}/learnt.nc"',
    ]

    def fill(target: pathlib.Path) -> None:
        data = netcdf_bytes(found.posterior.to_dataset())
        (target / "learnt.nc").write_bytes(data)
        (target / "learnt.toml").write_text("\n".join(toml) + "\n", encoding="utf-8")
        text = "\n".join(lines) + "\n"
        (target / "summary.txt").write_text(text, encoding="utf-8")
        (target / "learn.toml").write_text(measured.source, encoding="utf-8")

    return fill


def _figures(folder: pathlib.Path, found: "LearnedMachine") -> dict:
    """Figures of what was learnt, written."""
    from ..viz import write_learning_figures

    return write_learning_figures(folder, found)


def _with_figures(
    folder: pathlib.Path,
    measured: "MeasuredJob",
    found: "LearnedMachine",
    progress: Progress,
) -> int:
    """Add figures and report to results without a next command; return the code."""
    from ._pages.learning import learnt_report

    attempts = Attempts()

    def draw(target: pathlib.Path) -> None:
        with attempts.at("figures"):
            names = list(_figures(target, found))
            learnt_report(measured, found, _lines(measured, found)).write(target, names)

    with progress:
        progress.begin("figures and report")
        attempts.add(folder, draw)
    progress.write(f"results: {folder}")
    return attempts.conclude(folder)
