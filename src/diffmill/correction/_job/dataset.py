"""A correction as labelled arrays: every case with the same figures."""

from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._result import RESULTS
from ...workpiece import SurfaceError
from .._core.error_metrics import command_acceleration
from .._core.path_segments import PathParts

if TYPE_CHECKING:
    import xarray

    from .correct import Correction

# Rows that all cases share.
_SHARED = ("desired", "is_cutting")
_PART_FIGURES = {
    "rms": "root mean square contour error",
    "p95": "95 % of the rows have a smaller contour error",
    "max": "largest contour error",
}
_SURFACE_FIGURES = {
    "mean": "mean signed error of the {}s, positive where material was left",
    "rms": "root mean square error of the {}s",
    "p95": "95 % of the {}s' points are closer to the ideal surface",
    "deepest": "largest depth of a cut into the ideal part",
}


def correction_dataset(
    correction: "Correction", surfaces: dict[str, SurfaceError] | None = None
) -> "xarray.Dataset":
    """Cases on the dimension `case`, costs in the attributes.

    Args:
        correction: The correction.
        surfaces: Errors of the surface, see `Correction.to_dataset`.
    """
    import xarray

    names = list(correction.cases)
    tables = [correction.cases[name].to_dataset() for name in names]
    dataset = xarray.concat(
        tables,
        dim=xarray.DataArray(names, dims="case", name="case"),
        data_vars=[str(name) for name in tables[0] if name not in _SHARED],
        combine_attrs="drop_conflicts",
    )
    left_out = ""
    if surfaces is None:
        try:
            surfaces = correction.surfaces()
        except ValueError as error:
            # The correction is worth more than this figure of it.
            surfaces, left_out = {}, str(error)
    figures = {**_figures(correction), **_surface_figures(surfaces)}
    dataset = dataset.assign(figures).assign_coords(part=list(PathParts.NAMES))
    for name, method in correction.methods.items():
        dataset.attrs[f"{name}_wall_time_s"] = correction.wall_time[name]
        dataset.attrs[f"{name}_forward_runs"] = method.forward_runs
        dataset.attrs[f"{name}_linearisations"] = method.linearisations
        for key, value in method.detail.items():
            dataset.attrs[f"{name}_{key}"] = value
    if left_out:
        dataset.attrs["surface_left_out"] = left_out
    dataset.attrs["corrected_case"] = correction.chosen
    is_settled = bool(
        correction.methods[correction.chosen].result == RESULTS.successful
    )
    dataset.attrs["corrected_outcome"] = "settled" if is_settled else "steps ran out"
    return dataset


def _figures(correction: "Correction") -> dict[str, tuple[Any, ...]]:
    """Figures of all cases as variables of a dataset."""
    parts = correction.path_parts
    contours = [method.contour for method in correction.methods.values()]
    tables = [parts.figures(np.linalg.norm(contour, axis=1)) for contour in contours]
    means = np.stack(
        [np.mean(contour[parts.index >= 0], axis=0) for contour in contours]
    )
    accelerations = []
    for solution in correction.cases.values():
        time = np.asarray(solution.time, np.float64)
        time_step = float((time[-1] - time[0]) / (len(time) - 1))
        accelerations.append(command_acceleration(solution.commanded, time_step))
    meaning = "mean of the vector from the desired path to the tip, where the tool cuts"
    variables: dict[str, tuple[Any, ...]] = {
        "path_part": (
            ("step",),
            parts.index.astype(np.int8),
            {
                "units": "1",
                "long_name": "part of the path, -1 where the tool does not cut",
                "flag_values": np.arange(len(parts.NAMES), dtype=np.int8),
                "flag_meanings": " ".join(parts.NAMES),
            },
        ),
        "contour_mean": (("case", "axis"), means, _about("m", meaning)),
        "part_rows": (
            ("part",),
            tables[0]["rows"].astype(np.int32),
            _about("1", "rows that belong to the part"),
        ),
        "max_acceleration": (
            ("case",),
            np.array([each.max() for each in accelerations]),
            _about("m s-2", "largest acceleration of the commanded tip"),
        ),
        "p95_acceleration": (
            ("case",),
            np.array([np.percentile(each, 95) for each in accelerations]),
            _about("m s-2", "95 % of the rows have a smaller acceleration"),
        ),
    }
    before = correction.before
    left = np.stack(
        [
            parts.is_out_of_cut(
                solution.force,
                rigid_force=before.rigid.force,
                desired=before.desired,
            )
            for solution in correction.cases.values()
        ]
    )
    meaning = "where nothing pushes the tool but it should be in a full cut"
    variables["is_out_of_cut"] = (("case", "step"), left, _about("1", meaning))
    variables["rows_out_of_cut"] = (
        ("case",),
        np.sum(left, axis=1).astype(np.int32),
        _about("1", f"rows {meaning}"),
    )
    for key, text in _PART_FIGURES.items():
        values = np.stack([table[key] for table in tables])
        variables[f"part_{key}"] = (("case", "part"), values, _about("m", text))
    return variables


def _surface_figures(
    surfaces: dict[str, SurfaceError],
) -> dict[str, tuple[Any, ...]]:
    """Errors of the machined surface as variables, walls and floors apart."""
    if not surfaces:
        return {}
    measures = [error.measures() for error in surfaces.values()]
    variables = {}
    for field in fields(measures[0]):
        text = _SURFACE_FIGURES[field.name.split("_")[-1]].format(
            field.name.split("_")[0]
        )
        values = np.array([getattr(measure, field.name) for measure in measures])
        variables[f"surface_{field.name}"] = (("case",), values, _about("m", text))
    places = np.stack([error.deepest_at for error in surfaces.values()])
    about = _about("m", "where the tool cut deepest into the ideal part")
    variables["surface_deepest_at"] = (("case", "axis"), places, about)
    return variables


def _about(units: str, meaning: str) -> dict[str, Any]:
    return {"units": units, "long_name": meaning}
