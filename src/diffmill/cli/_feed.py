"""The feed of a job: error against time as a table and a figure, and tuned paths."""

import dataclasses
import pathlib
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from .._jax_config import configure_jax
from .._messages import printable
from .._results_folder import ResultsFolder
from ._run_job import with_job
from ._session.attempts import Attempts
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
    from ..correction import FastestFeed, FeedTradeoff, TunedFeed
    from ..toolpath import Path
    from ..units import QuantityKind
    from ._session.feed_request import FeedRequest

# xarray is imported when there is something to write.
Dataset: TypeAlias = Any
# Smallest override along the path.
_LOWEST = 0.5


def run_feed(
    file: pathlib.Path,
    request: "FeedRequest",
    out: pathlib.Path | None,
    *,
    force: bool,
    progress: Progress,
    allow_outside: bool,
) -> int:
    """Simulate a job at several feeds, tune the feed along its path; write a folder.

    Args:
        file: The job file.
        request: The feeds to try.
        out: Folder for the results, or None for `./<job>-feed`.
        force: True to replace results that are there.
        progress: Shows how far it is.
        allow_outside: True if the job may name files outside its folder.

    Returns:
        The exit code.
    """
    folder = pathlib.Path(f"{file.stem}-feed") if out is None else out
    with bad_input():
        ResultsFolder.of(folder).check(force=force)
    # Imports that take seconds wait until they are needed.
    from ..config import job_precision, load_job

    with bad_input():
        configure_jax(job_precision(file))
        with progress:
            progress.begin("reading the job")
            job = load_job(file, allow_outside=allow_outside)
        _check(job, file, request)
    with locked_folder(folder) as unlocked:
        for note in (*job.notes, *filter(None, [unlocked])):
            progress.write(f"note: {note}")
        if request.tolerance is not None:
            return _fastest(job, request, folder, progress, force=force)
        return _tune(job, request, folder, progress, force=force)


def _fastest(
    job: "Job",
    request: "FeedRequest",
    folder: pathlib.Path,
    progress: Progress,
    *,
    force: bool,
) -> int:
    """Find the fastest feed within a tolerance, and write it; return the exit code."""
    from ..correction import fastest_feed
    from ..units import FORCE, LENGTH, POWER

    tolerance = _positive("--tolerance", request.tolerance, LENGTH)
    most_force = _positive("--max-force", request.max_force, FORCE)
    most_power = _positive("--max-power", request.max_power, POWER)
    with progress, bad_correction(job.name, "that the feed could change"):
        found = fastest_feed(
            job,
            tolerance,
            max_force=most_force,
            max_power=most_power,
            corrects=request.correct,
            knots=request.along,
            on_progress=progress.update,
        )
    lines = _fastest_lines(job, found)
    files: dict[str, str] = {}
    if found.path is not None and found.commanded is not None:
        from ._written.corrected import corrected_files

        at_feed = dataclasses.replace(job, path=found.path)
        files, written = corrected_files(at_feed, found.commanded, name="fastest")
        lines += written
    elif found.path is not None:
        files = _path_files("fastest", job, found.path, "the fastest feed")
    progress.answer("\n".join(lines))
    files["summary.txt"] = "\n".join(lines) + "\n"
    folder = ResultsFolder.of(folder).still_free(force=force)
    from ..io import write_results
    from ..viz import plot_fastest_feed, save_figure
    from ._pages.feed import fastest_report

    tried = found.to_dataset()
    write_results(folder, with_job(tried, job), files=files, force=force)
    limits = [f"a contour error of {request.tolerance}"]
    limits += [f"a force of {request.max_force}"] if request.max_force else []
    limits += [f"a power of {request.max_power}"] if request.max_power else []
    limits += ["the speeds of the joints"] if job.robot is not None else []
    page = fastest_report(job, found, tuple(limits), "\n".join(lines))

    def draw(target: pathlib.Path) -> None:
        save_figure(plot_fastest_feed(tried, tolerance), target / "fastest.png")
        page.write(target, ["fastest"])

    code = _with_pictures(folder, draw)
    progress.write(f"results: {folder}")
    return code


def _with_pictures(folder: pathlib.Path, draw: Callable[[pathlib.Path], object]) -> int:
    """Add a figure and the report to results; return the exit code."""
    attempts = Attempts()

    def fill(target: pathlib.Path) -> None:
        with attempts.at("report"):
            draw(target)

    with interruption_leaves(lambda: f"{folder} has the results without the report"):
        attempts.add(folder, fill)
    return attempts.conclude(folder)


def _fastest_lines(job: "Job", found: "FastestFeed") -> list[str]:
    """Table of the feeds that were tried, and the best of them."""
    lines = [
        f"{job.name}: largest contour error [um], force [N], power of the spindle [W] "
        "and joint speed [%]",
        f"{'override':>10}{'time [s]':>10}{'error':>10}{'force':>10}{'power':>10}"
        f"{'speed':>8}",
    ]
    for one in sorted(found.tried, key=lambda one: one.override):
        mark = f"  beyond the limit: {one.broken}" if one.broken else ""
        speed = f"{100 * one.joint_speed:.0f}" if job.robot is not None else "-"
        lines.append(
            f"{one.override:10.3f}{one.cycle_time:10.2f}{1e6 * one.error:10.1f}"
            f"{one.force:10.0f}{one.power:10.0f}{speed:>8}{mark}"
        )
    if found.best is None:
        return [*lines, "no feed that was tried keeps the limits"]
    why = f"; the next larger breaks: {found.limited_by}" if found.limited_by else ""
    time = f"{found.best.cycle_time:.2f} s"
    if found.along is not None:
        low, high = found.along.min(), found.along.max()
        return [
            *lines,
            f"fastest: override along the path {low:.3f} to {high:.3f}, {time}",
        ]
    return [*lines, f"fastest: override {found.best.override:.3f}, {time}{why}"]


def _positive(option: str, text: str | None, kind: "QuantityKind") -> float:
    """Value of an option; infinite where it is not given.

    Raises:
        BadInput: It is no such quantity, or not positive.
    """
    from ..units import quantity

    if text is None:
        return np.inf
    try:
        value = quantity(text, kind)
    except ValueError as error:
        raise BadInput(f"{option}: {error}") from error
    if not 0 < value < np.inf:
        raise BadInput(f"{option}: found {text}, but a size above 0 is required")
    return value


def _path_files(name: str, job: "Job", path: "Path", what: str) -> dict[str, str]:
    """Path as CSV, and of a tool that is upright as a program."""
    from ..io import program_frame, write_gcode, write_path_csv

    files = {f"{name}.csv": write_path_csv(path)}
    if path.is_upright:
        files[f"{name}.ngc"] = write_gcode(
            path,
            header=[f"{job.name}, {what} by diffmill"],
            spindle_speed=float(job.spindle_speed),
            frame=program_frame(job.program, np.asarray(path.line).tolist()),
        )
    return files


def _tune(
    job: "Job",
    request: "FeedRequest",
    folder: pathlib.Path,
    progress: Progress,
    *,
    force: bool,
) -> int:
    """Compute and write the results; return the exit code."""
    from .._result import SimulationFailed

    try:
        with progress:
            tradeoff, tuned, tuning_failure = _compute(job, request, progress)
    except SimulationFailed as failure:
        print(printable(f"error: the run failed: {failure}"), file=sys.stderr)
        print("nothing could be kept", file=sys.stderr)
        return 1
    progress.answer("\n".join(_summary(job, tradeoff, tuned)))
    folder = ResultsFolder.of(folder).still_free(force=force)
    code = _write(folder, job, tradeoff, tuned, force=force)
    progress.write(f"results: {folder}")
    if tuning_failure:
        print(
            f"error: the feed could not be tuned: {tuning_failure}; {folder} has the "
            "rest",
            file=sys.stderr,
        )
        return 1
    return code


def _check(job: "Job", file: pathlib.Path, request: "FeedRequest") -> None:
    """Refuse a request that cannot be run, before anything runs."""
    from .._toml import JobError
    from ..toolpath import PathFeed

    if job.is_rigid:
        raise JobError(
            file,
            [
                "[robot] rigid: found true, but feed needs a machine that is soft: "
                "model or file, or [machine]"
            ],
        )
    if job.commanded is not None:
        raise JobError(file, [ONLY_SIMULATE])
    # With a tolerance and --correct it writes the corrected program, as `correct`.
    writes_corrected = request.correct and request.tolerance is not None
    has_gcode = ".ngc" in job.output.suffixes
    if writes_corrected and has_gcode and not job.path.is_upright:
        raise JobError(file, [NO_TILT])
    from ..units import FORCE, LENGTH, POWER

    _positive("--tolerance", request.tolerance, LENGTH)
    _positive("--max-force", request.max_force, FORCE)
    _positive("--max-power", request.max_power, POWER)
    if request.along == 1 or request.along < 0:
        raise BadInput(
            f"--along: found {request.along}, but 0 or 2 and more are allowed"
        )
    if request.along and request.tolerance is None:
        raise BadInput("--along: found without --tolerance, with which it counts")
    for option, limit in (
        ("--max-force", request.max_force),
        ("--max-power", request.max_power),
    ):
        if limit is not None and request.tolerance is None:
            raise BadInput(f"{option}: found without --tolerance, with which it counts")
    for name, values in (
        ("--overrides", request.overrides),
        ("--weights", request.weights),
    ):
        if not all(0 < value < np.inf for value in values):
            found = " ".join(f"{value:g}" for value in values)
            raise BadInput(f"{name}: found {found}, but numbers above 0 are required")
    if not request.overrides:
        raise BadInput("--overrides: found none, but at least one is required")
    names = [f"{weight:g}" for weight in request.weights]
    if len(set(names)) < len(names):
        raise BadInput(f"--weights: found {' '.join(names)}, but each may occur once")
    least = min([*request.overrides, *[_LOWEST] * bool(request.weights)])
    feed = PathFeed.of_path(job.path)
    try:
        feed.row_count(least)
    except ValueError as error:
        raise BadInput(f"override {least:g}: {error}") from error


def _compute(
    job: "Job", request: "FeedRequest", progress: Progress
) -> "tuple[FeedTradeoff, TunedFeed | None, str]":
    """Run the job at all feeds, and tune its feed if that was asked for.

    Returns:
        The job at all feeds; with its feed tuned, or None; the reason why tuning
        failed, or an empty text.
    """
    from .._result import SimulationFailed
    from ..correction import feed_tradeoff, tune_feed

    with bad_correction(job.name, "that the feed could change"):
        tradeoff = feed_tradeoff(
            job,
            request.overrides,
            corrects=request.correct,
            on_progress=progress.update,
        )
        if not request.weights:
            return tradeoff, None, ""
        try:
            tuned = tune_feed(
                job,
                time_weights=request.weights,
                lowest=_LOWEST,
                on_progress=progress.update,
            )
        except (SimulationFailed, ValueError) as failure:
            # The errors at all feeds are known by now.
            return tradeoff, None, str(failure)
        return tradeoff, tuned, ""


def _write(
    folder: pathlib.Path,
    job: "Job",
    tradeoff: "FeedTradeoff",
    tuned: "TunedFeed | None",
    *,
    force: bool,
) -> int:
    """Write numbers and tuned paths, then figure and report; return the exit code."""
    from ..io import write_results
    from ..viz import plot_feed, save_figure
    from ._pages.feed import tradeoff_report

    lines = _summary(job, tradeoff, tuned)
    even = tradeoff.to_dataset()
    along = None if tuned is None else tuned.to_dataset()
    dataset: Dataset = even
    files: dict[str, str] = {}
    if tuned is not None and along is not None:
        names = {name: f"tuned_{name}" for name in along.data_vars}
        dataset = even.merge(along.rename(names))
        for point, path in zip(tuned.points[1:], tuned.paths[1:], strict=True):
            what = f"feed tuned for a weight of the time of {point.weight:g}"
            files |= _path_files(f"tuned_{point.weight:g}", job, path, what)
    write_results(folder, with_job(dataset, job), files=files, force=force)
    page = tradeoff_report(job, tradeoff, tuned, "\n".join(lines))

    def draw(target: pathlib.Path) -> None:
        save_figure(plot_feed(even, along), target / "feed.png")
        page.write(target, ["feed"])

    return _with_pictures(folder, draw)


def _summary(
    job: "Job", tradeoff: "FeedTradeoff", tuned: "TunedFeed | None"
) -> list[str]:
    """Table of errors and times."""
    lines = [
        f"{job.name}: contour error, rms over the length that is cut [um]",
        f"{'override':>10}{'time [s]':>10}{'f_z [mm]':>10}{'program':>10}"
        f"{'corrected':>11}",
    ]
    for k in np.argsort(tradeoff.override):
        error = 1e6 * tradeoff.corrected[k]
        after = f"{error:11.2f}" if np.isfinite(error) else f"{'-':>11}"
        lines.append(
            f"{tradeoff.override[k]:10g}{tradeoff.cycle_time[k]:10.2f}"
            f"{1e3 * tradeoff.feed_per_tooth[k]:10.4f}"
            f"{1e6 * tradeoff.uncorrected[k]:10.2f}{after}"
        )
    if tuned is None:
        return lines
    lines.append("overrides along the path, the program not corrected")
    lines.append(f"{'weight':>10}{'time [s]':>10}{'program':>10}  override")
    for point in tuned.points[1:]:
        low, high = point.override.min(), point.override.max()
        end = "" if point.is_settled else " (steps ran out)"
        lines.append(
            f"{point.weight:10g}{point.cycle_time:10.2f}{1e6 * point.rms:10.2f}"
            f"  {low:.2f} to {high:.2f}{end}"
        )
    return lines
