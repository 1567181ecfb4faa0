"""The pictures, the report and the surface error of a finished run."""

import pathlib
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from .._job import Job
    from ..viz import SurfaceError

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
        solutions: Solutions by case, the uncorrected one first; the case of a
            simulation is "predicted".
        dataset: The dataset of `result.nc`.
    """
    from ..viz import figure_inputs, write_figures, write_report

    inputs = figure_inputs(job, solutions)
    surfaces = inputs["surfaces"]
    write_surface(folder / "surface.nc", surfaces)
    figures = write_figures(folder, dataset, **inputs)
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
