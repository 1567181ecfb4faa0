"""Results on disk: a dataset with units and versions, and files beside it."""

import os
import pathlib
import platform
from collections.abc import Callable, Mapping
from importlib import metadata
from typing import Any, TypeAlias

import numpy as np

from .._results_folder import ResultsFolder, netcdf_bytes
from ..workpiece import Stock, save

# xarray takes half a second to import, which only these functions need.
Dataset: TypeAlias = Any
Content: TypeAlias = str | bytes | Callable[[pathlib.Path], object]

_UNITS = {
    "step": "1",
    "time": "s",
    "desired": "m",
    "commanded": "m",
    "actual": "m",
    "deviation": "m",
    "surface_deviation": "m",
    "contour_error": "m",
    "force": "N",
    "removed_volume": "m3",
    "is_cutting": "1",
}
_PACKAGES = ("diffmill", "jax", "jaxlib", "equinox", "numpy", "scipy", "xarray")


def write_results(
    out: str | os.PathLike[str],
    dataset: Dataset,
    *,
    files: Mapping[str, Content] | None = None,
    fill: Callable[[pathlib.Path], object] | None = None,
    stock: Stock | None = None,
    force: bool = False,
) -> pathlib.Path:
    """Write a folder of results, all of it or nothing.

    Args:
        out: The folder.
        dataset: Content of `result.nc`; units and versions are added where absent.
        files: Further files by name: text, bytes, or a function that is called with
            the path of the file.
        fill: Called with the folder itself, to write any number of files.
        stock: The final stock, for `stock.npz`.
        force: Whether to replace the results in a folder that is not empty; files
            that no earlier run wrote stay.

    Returns:
        The folder.

    Raises:
        ResultsError: If the folder is not empty, or cannot be written to.
    """

    def fill_all(folder: pathlib.Path) -> None:
        (folder / "result.nc").write_bytes(netcdf_bytes(described(dataset)))
        if stock is not None:
            save(stock, folder / "stock.npz")
        for name, content in (files or {}).items():
            if not ResultsFolder(folder).has_place_for(name):
                raise ValueError(f"File `{name}` must lie directly in the folder.")
            if callable(content):
                content(folder / name)
            elif isinstance(content, bytes):
                (folder / name).write_bytes(content)
            else:
                (folder / name).write_text(content, encoding="utf-8", newline="\n")
        if fill is not None:
            fill(folder)

    folder = ResultsFolder.of(out)
    folder.write(fill_all, force=force)
    return folder.path


def described(dataset: Dataset) -> Dataset:
    """Return a dataset with units on every variable, versions and conventions.

    Args:
        dataset: The dataset; attributes that it has are kept.

    Raises:
        ValueError: If a numeric variable has no units and none are known for it.
    """
    dataset = dataset.copy()
    for name, variable in dataset.variables.items():
        if variable.dtype.kind not in "fiub" or "units" in variable.attrs:
            continue
        if name not in _UNITS:
            raise ValueError(f"Variable `{name}` must have the attribute `units`.")
        dataset[name].attrs["units"] = _UNITS[str(name)]
    versions = [f"{name} {metadata.version(name)}" for name in _PACKAGES]
    added = {
        "Conventions": "CF-1.11",
        "versions": ", ".join([f"python {platform.python_version()}", *versions]),
        "incomplete": np.int32(0),
    }
    attributes = {**added, **dataset.attrs}
    dataset.attrs = {k: _plain(v) for k, v in attributes.items() if v is not None}
    return dataset


def _plain(value: object) -> object:
    """Return an attribute as netCDF can hold it."""
    if isinstance(value, bool | np.bool_):
        return np.int32(value)
    if isinstance(value, str | int | float | np.generic | np.ndarray):
        return value
    array = np.asarray(value)
    return array if array.dtype.kind in "fiu" else str(value)


def mark_incomplete(
    dataset: Dataset, reason: str, *, failed_step: int | None = None
) -> Dataset:
    """Rows of an aborted run before its failure, with its reason and place.

    Args:
        dataset: Rows of all steps.
        reason: Why the run stopped.
        failed_step: First row that is not to be trusted; by default the first with a
            position that is not finite.

    Returns:
        The rows before that one (at least one), with the attributes `incomplete` = 1,
        `incomplete_reason`, `incomplete_time` [s] and `incomplete_place` (desired
        tip in `work` [m]) of the failed row.
    """
    actual = dataset["actual"]
    other = [dim for dim in actual.dims if dim != "step"]
    is_good = np.isfinite(actual).all(dim=other).values
    if failed_step is not None:
        is_good[failed_step:] = False
    count = is_good.size if is_good.all() else int(np.argmin(is_good))
    last = min(count, is_good.size - 1)
    desired = np.asarray(dataset["desired"].isel(step=last))
    return dataset.isel(step=slice(0, max(count, 1))).assign_attrs(
        incomplete=np.int32(1),
        incomplete_reason=reason,
        incomplete_time=float(dataset["time"].isel(step=last)),
        incomplete_place=desired.reshape(-1, 3)[0].astype(float),
    )
