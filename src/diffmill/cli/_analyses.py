"""The analyses and figures of a run, added to results that are already written."""

import concurrent.futures
import dataclasses
import pathlib
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from .._jax_config import give_back_memory
from .._results_folder import netcdf_bytes
from ._session.attempts import Attempts
from ._session.progress import Progress

if TYPE_CHECKING:
    from .._job import Job
    from ..config import JobProgram
    from ..sim import Stability
    from ..viz import StudyReport
    from ..workpiece import SurfaceError

# Cases whose commands run on drawn machines, besides the corrected one.
_TRUE_CASES = ("uncorrected", "mirror")
# Tooth periods from which on they run on one of these machines alone.
_LONG_ROWS = 20_000
# Figures that the rows of the dataset suffice for.
_FIGURES_OF_ROWS = ("paths", "deviation")
# xarray and the parts that compute are imported when a job runs.
Dataset: TypeAlias = Any
Solution: TypeAlias = Any


class FinishedRun(NamedTuple):
    """A run whose results are written.

    Attributes:
        job: The job.
        solutions: Solutions by case, the uncorrected one first; the case of a
            simulation is "predicted".
        final: The solution whose command is the result.
        dataset: The content of `result.nc`.
        program: The job's program before it was timed, where its block ends are moved.
        surfaces: Surface errors of the solutions; None where they are not computed.
        chatter: Chatter of the uncorrected path, which the user knows; None if there
            is none.
        draw: Writes further figures of the report to a folder; None without any.
        study: What measured parts showed, for the report; None without any.
    """

    job: "Job"
    solutions: dict[str, Solution]
    final: Solution
    dataset: Dataset
    program: "JobProgram | None" = None
    surfaces: "Mapping[str, SurfaceError] | None" = None
    chatter: "Stability | None" = None
    draw: "Callable[[pathlib.Path], dict[str, Any]] | None" = None
    study: "StudyReport | None" = None


def add_analyses(folder: pathlib.Path, run: FinishedRun, progress: Progress) -> int:
    """Add analyses, figures and the report to written results.

    Args:
        folder: The folder of the results.
        run: The run.
        progress: Prints the results, and what takes long.

    Returns:
        The exit code: 0, or 1 if one of them failed, which leaves the others.
    """
    from ..io import described
    from ..viz import summary

    attempts = Attempts()
    dataset = run.dataset
    if "corrected_case" in dataset.attrs:
        from ._written.corrected import untimed_programs

        untimed = untimed_programs(run.job).items()
        reasons = {f"written_untimed_{suffix[1:]}": why for suffix, why in untimed}
        run = run._replace(dataset=dataset.assign_attrs(reasons))
        dataset = run.dataset.assign_attrs(written_not_run=1)
        with progress, attempts.at("written program"):
            progress.begin("the written program, read back and run")
            dataset = _with_written(folder, run, progress)
    try:
        with progress:
            for name, step in (
                ("resolution", _with_resolution),
                ("contacts", _with_contacts),
                ("stability", _with_stability),
                ("sensitivity", _with_sensitivity),
                ("other machines", _with_mismatch),
                ("drawn machines", _with_true_errors),
                ("expected error", _with_expected_error),
            ):
                progress.begin(f"analysis: {name}")
                with attempts.at(name):
                    dataset = step(run._replace(dataset=dataset), progress)
    finally:
        # It includes chatter and scatter; after an interruption it has the others.
        with attempts.at("verdict"):
            if verdict := summary(dataset, "verdict"):
                progress.answer(verdict)

    def fill(target: pathlib.Path) -> None:
        finished = run._replace(dataset=described(dataset))
        result = _write_pictures(target, finished, attempts)
        (target / "result.nc").write_bytes(netcdf_bytes(result))

    # The search for chatter has read programs of its own.
    give_back_memory()
    with progress:
        progress.begin("figures and report")
        attempts.add(folder, fill)
    return attempts.conclude(folder)


def _with_written(
    folder: pathlib.Path, run: FinishedRun, progress: Progress
) -> Dataset:
    """Dataset with the contour errors of the written programs, which are printed."""
    from ._written.corrected import written_errors

    contours, lines = written_errors(run.job, run.final, folder, run.program)
    attributes = {}
    for name, contour in contours.items():
        file, _, suffix = name.rpartition(".")
        kind = "written" if file == "corrected" else file
        attributes[f"{kind}_rms_{suffix}"] = contour.rms
        attributes[f"{kind}_max_{suffix}"] = contour.max
    if not attributes:
        attributes["written_not_run"] = 1
    dataset = run.dataset.assign_attrs(attributes)
    return _with_notes(dataset, _printed(lines, progress))


def _with_resolution(run: FinishedRun, progress: Progress) -> Dataset:
    """Dataset with the error by reuse of the engagement, which is printed."""
    is_update = run.final.is_engagement_update
    error = run.final.engagement_force_error
    is_cut = np.asarray(run.final.is_cutting)
    if is_update is None or error is None or not is_cut.any():
        return run.dataset
    force = np.linalg.norm(np.asarray(run.final.force)[is_cut], axis=1)
    rms = lambda x: float(np.sqrt(np.mean(np.square(x))))
    off = rms(np.asarray(error)[is_cut])
    line = (
        'resolution: "adaptive": engagement updates in '
        f"{100 * np.mean(np.asarray(is_update)):.0f} % of the tooth periods; forces in "
        f"between are off by about {off:.2g} N rms where the tool cuts, "
        f"{100 * off / rms(force):.1f} % of them"
    )
    return _with_notes(run.dataset, _printed([line], progress))


def _with_contacts(run: FinishedRun, progress: Progress) -> Dataset:
    """Dataset with the contacts of holder and shank, which are printed."""
    from ..config import tool_notes
    from ..sim import ToolContacts

    job, solution, dataset = run.job, run.final, run.dataset
    contacts = None
    if job.holder is not None:
        contacts = ToolContacts.along(
            job.path,
            job.stock,
            job.cutter,
            job.holder,
            positions=np.asarray(solution.actual),
            checks_rapids=False,
        )
        dataset = dataset.assign(contacts.to_dataset().data_vars)
    notes = tool_notes(job.path, np.asarray(solution.shank_volume), contacts)
    lines = [f"warning: {note}" for note in notes]
    return _with_notes(dataset, _printed(lines, progress))


def _with_stability(run: FinishedRun, progress: Progress) -> Dataset:
    """Dataset with the growth of vibrations, which is printed unless it was before."""
    dataset, growth = run.dataset, run.chatter
    if growth is None:
        growth = job_stability(run.job, run.final)
        if growth is None:
            return dataset
        _printed(stability_lines(growth), progress)
    dataset = _with_notes(dataset, stability_lines(growth))
    return dataset.assign_attrs(
        stability_largest_radius=float(growth.radius[growth.strongest]),
        stability_frequency=float(growth.frequency[growth.strongest]),
        stability_has_chatter=int(growth.warning() is not None),
    )


def job_stability(job: "Job", solution: Solution) -> "Stability | None":
    """Growth of vibrations, by the method of the job.

    None where nothing is suspected, and of a path in the air.
    """
    from ..sim import Stability, stability

    check = job.simulation.stability
    if check == "none" or not np.asarray(solution.is_cutting).any():
        return None
    analyse = Stability.where_suspected if check == "quick" else stability
    return analyse(job, solution)


def stability_lines(growth: "Stability") -> list[str]:
    """Lines on the growth of vibrations."""
    warning = growth.warning()
    return [
        f"warning: {warning}" if warning else f"stability: {growth.note()}",
        f"stability: {growth.visibility()}",
    ]


def _with_sensitivity(run: FinishedRun, progress: Progress) -> Dataset:
    """Dataset with the sensitivity of the final command, if the job asks for it."""
    from ..sim import sensitivity

    if not run.job.simulation.has_sensitivity:
        return run.dataset
    progress.write("sensitivity: one derivative for each parameter")
    maps = sensitivity(run.job, commanded=np.asarray(run.final.commanded))
    return run.dataset.assign(maps.to_dataset().data_vars)


def _with_mismatch(run: FinishedRun, progress: Progress) -> Dataset:
    """Dataset with the error of the command beside the model, which is printed."""
    from ..sim import mismatch

    if "corrected_case" not in run.dataset.attrs:
        return run.dataset
    progress.write("other machines: the command where the model is off")
    mismatches = mismatch(run.job, run.final)
    text = lambda rms: f"{1e6 * rms:.3g} um rms" if np.isfinite(rms) else "no result"
    lines = [
        f"with {x.share:.0%} less or more {x.kind} than in the model the command "
        f"leaves {text(x.less)} or {text(x.more)}"
        for x in mismatches
    ]
    attributes = {f"mismatch_rms_{x.kind}": x.worse for x in mismatches}
    attributes["mismatch_share"] = mismatches[0].share
    lines = _printed(lines, progress)
    return _with_notes(run.dataset.assign_attrs(attributes), lines)


def _with_true_errors(run: FinishedRun, progress: Progress) -> Dataset:
    """Dataset with the errors of the commands on drawn machines, which are printed."""
    from ..sim import TrueErrors

    job, chosen = run.job, run.dataset.attrs.get("corrected_case")
    if chosen is None or job.truth.draws == 0:
        return run.dataset
    if job.robot is None:
        progress.write("no machine is drawn about the model: it has no joints")
        return run.dataset
    truth, rows = job.truth, job.path.step_count
    if rows > _LONG_ROWS and truth.draws > 1:
        progress.write(
            f"one machine of [truth] alone: the path has {rows} tooth periods"
        )
        truth = dataclasses.replace(truth, draws=1)
    progress.write(f"machines as [truth] draws them about the model: {truth.draws}")
    cases = [name for name in run.solutions if name in _TRUE_CASES or name == chosen]
    commands = {name: np.asarray(run.solutions[name].commanded) for name in cases}
    errors = TrueErrors.of_commands(job, truth, commands)
    found = [
        f"{case} {1e6 * errors.median(case):.3g} [{1e6 * errors.worst(case):.3g}] um"
        if np.isfinite(errors.worst(case))
        else f"{case} no result"
        for case in cases
    ]
    line = (
        f"on {errors.draws} machines drawn about the model ([truth]: reversal, links, "
        "stiffness, forces) the commands leave "
        f"{', '.join(found)} rms, median [largest]"
    )
    dataset = run.dataset.assign_attrs(
        truth_draws=errors.draws,
        truth_rms_median=errors.median(chosen),
        truth_rms_largest=errors.worst(chosen),
        truth_rms_uncorrected=errors.median("uncorrected"),
    )
    return _with_notes(dataset, _printed([line], progress))


def _with_expected_error(run: FinishedRun, progress: Progress) -> Dataset:
    """Dataset with the expected error under the scatter of the model, if given."""
    from ..sim import error_band

    if run.job.simulation.scatter is None:
        return run.dataset
    progress.write("expected error: the linear system around the run")
    band = error_band(run.job, run.final)
    most = list(band.shares().items())[:3]
    shares = ", ".join(f"{name} {size * 1e6:.2f}" for name, size in most)
    line = (
        f"expected error: {band.rms * 1e6:.2f} um rms where the tool cuts, with the "
        f"scatter of the model; most by {shares} um"
    )
    added = band.to_dataset()
    dataset = run.dataset.assign(added.data_vars).assign_attrs(added.attrs)
    return _with_notes(dataset, _printed([line], progress))


def _printed(lines: list[str], progress: Progress) -> list[str]:
    """Lines as they are, which it prints."""
    for line in lines:
        progress.write(line)
    return lines


def _with_notes(dataset: Dataset, lines: list[str]) -> Dataset:
    """Dataset whose attributes hold further notes."""
    notes = [dataset.attrs["notes"]] if "notes" in dataset.attrs else []
    return dataset.assign_attrs(notes="\n".join([*notes, *lines])) if lines else dataset


def _write_pictures(
    folder: pathlib.Path, run: FinishedRun, attempts: Attempts
) -> Dataset:
    """Write figures, `report.html` and `surface.nc`; return the dataset with notes."""
    from ..viz import figure_inputs, write_figures, write_report

    inputs, figures = {}, {}
    chosen = run.dataset.attrs.get("corrected_case", "")
    with concurrent.futures.ThreadPoolExecutor(1) as pool:
        # Compiled code leaves the interpreter free to draw what needs no inputs.
        computed = pool.submit(
            figure_inputs, run.job, run.solutions, run.surfaces, chosen=chosen
        )
        with attempts.at("figures"):
            of_rows = lambda name: name in _FIGURES_OF_ROWS
            figures = write_figures(folder, run.dataset, is_chosen=of_rows)
        with attempts.at("surface"):
            inputs = computed.result()
            if inputs["surfaces"]:
                _write_surface(folder / "surface.nc", inputs["surfaces"])
    with attempts.at("figures"):
        others = lambda name: name not in _FIGURES_OF_ROWS
        figures |= write_figures(folder, run.dataset, is_chosen=others, **inputs)
        if run.draw is not None:
            figures |= run.draw(folder)
    dataset = _with_notes(run.dataset, [f"warning: {x}" for x in attempts.lines()])
    with attempts.at("report"):
        write_report(
            folder,
            dataset,
            figures,
            surfaces=inputs.get("surfaces"),
            job=run.job,
            study=run.study,
        )
    return dataset


def _write_surface(file: pathlib.Path, surfaces: "dict[str, SurfaceError]") -> None:
    """Write the errors of the machined surface as netCDF, a row for each point.

    Args:
        file: Path of the file.
        surfaces: Surface error by case.
    """
    import xarray

    def rows(name: str) -> np.ndarray:
        return np.concatenate([getattr(item, name) for item in surfaces.values()])

    def about(meaning: str, units: str = "1") -> dict[str, str]:
        return {"units": units, "long_name": meaning}

    counts = [len(item.error) for item in surfaces.values()]
    distance = "distance from the ideal surface, positive where material was left"
    normal = "outward normal of the ideal surface at its nearest place"
    dataset = xarray.Dataset(
        {
            "surface_error": ("point", rows("error"), about(distance, "m")),
            "position": (
                ("point", "axis"),
                rows("points"),
                about("point on the machined surface in work", "m"),
            ),
            "normal": (("point", "axis"), rows("normal"), about(normal)),
            "is_floor": ("point", rows("is_floor"), about("a floor, else a wall")),
            "is_cut": (
                "point",
                rows("is_cut"),
                about("a tool cut the point, else it is left of the raw stock"),
            ),
        },
        coords={
            "case": ("point", np.repeat(list(surfaces), counts)),
            "axis": ["x", "y", "z"],
        },
        attrs={"Conventions": "CF-1.11"},
    )
    file.write_bytes(netcdf_bytes(dataset))
