"""The pictures, the report and the surface error of a finished run."""

import pathlib
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from .._job import Job
    from ..viz import ChipChart, ForceRecord, SurfaceError

Dataset: TypeAlias = Any
Solution: TypeAlias = Any


def write_pictures(
    folder: pathlib.Path,
    job: "Job",
    solutions: dict[str, Solution],
    dataset: Dataset,
) -> None:
    """Write figures, `report.html` and `surface.nc` to a folder.

    Args:
        folder: Existing folder.
        job: The job.
        solutions: Solutions by case; the last is the one that is shown in detail.
        dataset: The dataset of `result.nc`.
    """
    from ..sim import with_precision
    from ..viz import cut_dexels, surface_error, write_figures, write_report

    job = with_precision(job)
    first, last = next(iter(solutions.values())), list(solutions.values())[-1]
    ideal = last.rigid.stock
    surfaces = {n: surface_error(s.stock, ideal) for n, s in solutions.items()}
    write_surface(folder / "surface.nc", surfaces)
    figures = write_figures(
        folder,
        dataset,
        forces=_forces(job, first),
        chip=_chip(job, first),
        dexels=cut_dexels(first.stock, ideal),
        surfaces=surfaces,
    )
    write_report(folder, dataset, figures, surfaces=surfaces)


def write_surface(file: pathlib.Path, surfaces: "dict[str, SurfaceError]") -> None:
    """Write height errors of the machined surface as netCDF.

    Args:
        file: Path of the file.
        surfaces: Height error by case, all on the same grid.
    """
    import xarray

    grid = next(iter(surfaces.values()))
    errors = np.stack([surface.error for surface in surfaces.values()])
    meaning = "height of the machined floor above the ideal one"
    dataset = xarray.Dataset(
        {
            "surface_error": (
                ("case", "y", "x"),
                errors,
                {"units": "m", "long_name": meaning},
            )
        },
        coords={
            "case": list(surfaces),
            "y": ("y", grid.y, {"units": "m"}),
            "x": ("x", grid.x, {"units": "m"}),
        },
        attrs={"Conventions": "CF-1.11"},
    )
    dataset.to_netcdf(file, engine="h5netcdf")


def _forces(job: "Job", solution: Solution) -> "ForceRecord":
    """Return the force within the tooth periods of a run, from its actual path."""
    from ..sim import job_plan, simulate_process
    from ..viz import force_record

    process = simulate_process(
        solution.actual,
        job.stock,
        job.cutter,
        job.law,
        job.spindle_speed,
        plan=job_plan(job),
        keeps_instantaneous=True,
    )
    samples = process.instantaneous_force
    assert samples is not None
    return force_record(np.asarray(solution.time), np.asarray(samples))


def _chip(job: "Job", solution: Solution) -> "ChipChart | None":
    """Return the chip of the first period in full cut, None if nothing is cut."""
    from ..sim import job_plan
    from ..viz import chip_chart

    removed = np.where(
        np.asarray(solution.is_cutting), np.asarray(solution.removed_volume), 0.0
    )
    if removed.max() <= 0:
        return None
    # A typical cut, not the peak of one period at the entry into the stock.
    typical = np.median(removed[removed > 0])
    step = max(1, int(np.argmax(removed >= typical)))
    return chip_chart(solution.desired, job.stock, job.cutter, job_plan(job), step=step)
