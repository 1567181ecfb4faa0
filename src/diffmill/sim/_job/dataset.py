"""Solutions as labelled arrays."""

from typing import TYPE_CHECKING, Any

import numpy as np

from ..._result import RESULTS

if TYPE_CHECKING:
    import pandas
    import xarray

    from .simulate import Solution

_ROWS = {
    "time": ("s", "time of the tooth instant"),
    "desired": ("m", "desired tip position in work"),
    "commanded": ("m", "tip position that the program commands, without gravity sag"),
    "actual": ("m", "actual tip position"),
    "force": ("N", "force on the tool in work, mean over the tooth period before"),
    "spindle_torque": ("N m", "torque of the spindle, mean over the period before"),
    "removed_volume": ("m3", "volume that the pose removes"),
    "shank_volume": ("m3", "what of it the shank above the flutes takes"),
    "deviation": ("m", "actual - desired"),
    "surface_deviation": ("m", "actual - desired when a tooth makes the wall"),
    "contour_error": ("m", "distance to the desired polyline when the wall was made"),
    "is_engagement_update": ("1", "the tooth period before has an engagement update"),
    "engagement_force_error": ("N", "estimated error by reuse of the engagement"),
    "is_cutting": ("1", "the rigid tool cuts in the tooth period before"),
    "motor_positions": ("", "motor positions on the joint's side, sag included"),
    "joint_positions": ("", "joint positions"),
}


def solution_dataset(solution: "Solution") -> "xarray.Dataset":
    """Return a solution as a dataset on the dimensions step, axis and joint."""
    import xarray

    variables = {}
    units = dict.fromkeys(solution.joint_units)
    of_joints = next(iter(units)) if len(units) == 1 else "rad or m, see joint_unit"
    for name, (unit, meaning) in _ROWS.items():
        values = getattr(solution, name)
        if values is None:
            continue
        array = np.asarray(values)
        array = array.astype(np.int8) if array.dtype == bool else array
        last = "joint" if name.endswith("_positions") else "axis"
        dims = ("step", last)[: array.ndim]
        variables[name] = (
            dims,
            array,
            {"units": unit or of_joints, "long_name": meaning},
        )
    steps = np.linalg.norm(np.diff(np.asarray(solution.desired), axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(steps)])
    coordinates: dict[str, Any] = {
        "axis": ["x", "y", "z"],
        "time": variables.pop("time"),
        "path_length": (
            "step",
            length,
            {"units": "m", "long_name": "length of the desired path so far"},
        ),
    }
    if solution.joint_positions is not None:
        coordinates["joint"] = list(solution.joint_names)
        coordinates["joint_unit"] = ("joint", list(solution.joint_units))
    return xarray.Dataset(
        variables,
        coords=coordinates,
        attrs={
            "initial_overlap_volume_m3": float(solution.initial_overlap_volume),
            "stock_volume_m3": float(solution.stock.volume()),
            "is_successful": int(bool(solution.result == RESULTS.successful)),
        },
    )


def solution_table(solution: "Solution") -> "pandas.DataFrame":
    """Return a solution as a table, its columns named as `force_x`."""
    import pandas

    columns = {}
    for name, variable in solution_dataset(solution).reset_coords().items():
        if variable.dims == ("step",):
            columns[str(name)] = variable.values
        elif variable.dims[:1] == ("step",):
            labels = variable.coords[variable.dims[1]].values
            columns |= {
                f"{name}_{label}": values
                for label, values in zip(labels, variable.values.T, strict=True)
            }
    return pandas.DataFrame(columns).rename_axis("step")
