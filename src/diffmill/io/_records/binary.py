"""Measured records as laboratory programs store them: TDMS, MAT and NetCDF."""

import contextlib
import functools
import importlib
import logging
import numbers
import pathlib
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from jaxtyping import Float, Shaped

from ...units import FORCE, TIME
from .table import Column, RecordError, Table, header_rate, split_unit

# A matrix with more columns than this is no record of channels.
_MOST_COLUMNS = 64


def read_tdms(path: pathlib.Path) -> Table:
    """Return the channels of a TDMS file, of all its groups."""
    nptdms = _package("nptdms", path)
    with _refusing(path, "TDMS"):
        file = nptdms.TdmsFile.read(path)
        channels = [channel for group in file.groups() for channel in group.channels()]
    shared = Counter(channel.name for channel in channels)
    columns = []
    for channel in channels:
        properties = channel.properties
        name, unit = split_unit(channel.name, FORCE, TIME)
        unit = str(
            properties.get("unit_string")
            or properties.get("NI_UnitDescription")
            or unit
        )
        if shared[channel.name] > 1:
            name = f"{channel.group_name}/{name}"
        step = float(properties.get("wf_increment") or 0.0)
        columns.append(
            Column(
                name,
                unit,
                lambda channel=channel: _numbers(channel[:]),
                1.0 / step if step > 0 else None,
            )
        )
    return _checked(path, Table(columns, _rate_in(file.properties)))


def read_mat(path: pathlib.Path) -> Table:
    """Return the vectors and the columns of matrices of a MAT file."""
    with path.open("rb") as stream:
        begin = stream.read(1024)
    if begin.startswith(b"MATLAB 7.3") or b"\x89HDF" in begin:
        pymatreader = _package("pymatreader", path)
        with _refusing(path, "MAT 7.3"):
            content = pymatreader.read_mat(str(path))
    else:
        from scipy.io import loadmat

        with _refusing(path, "MAT"):
            content = loadmat(path, simplify_cells=True)
    leaves = {n: value for n, value in _leaves(content) if not n.startswith("__")}
    scalars = {n: value for n, value in leaves.items() if np.ndim(value) == 0}
    shared = Counter(name.rpartition(".")[2] for name in leaves)
    columns = []
    for name, value in leaves.items():
        last = name.rpartition(".")[2]
        label = name if shared[last] > 1 else last
        columns += _matrix_columns(label, value, _sibling_labels(name, leaves))
    return _checked(path, Table(columns, _rate_in(scalars)))


def read_netcdf(path: pathlib.Path) -> Table:
    """Return the vectors and the columns of matrices of a NetCDF file."""
    import xarray

    columns = []
    with _refusing(path, "NetCDF"), xarray.open_dataset(path, decode_times=False) as d:
        data = d.load()
    for name, variable in data.variables.items():
        # "seconds since 2024-01-01" counts in seconds.
        unit = str(variable.attrs.get("units", "")).split(" since ")[0]
        labels = None
        if variable.ndim == 2 and variable.dims[1] in data.coords:
            labels = [f"{name} {label}" for label in data[variable.dims[1]].values]
        for column in _matrix_columns(str(name), variable.values, labels):
            columns.append(column._replace(unit=unit or column.unit))
    return _checked(path, Table(columns, _rate_in(data.attrs)))


def _package(name: str, path: pathlib.Path) -> Any:
    """Return a package of the extra `forces`."""
    try:
        return importlib.import_module(name)
    except ImportError:
        raise RecordError(
            str(path),
            [f"needs the package {name}: install diffmill with the extra `forces`."],
        ) from None


@contextlib.contextmanager
def _refusing(path: pathlib.Path, kind: str) -> Iterator[None]:
    """Turn whatever a foreign reader raises at a broken file into a `RecordError`.

    What it would print on the terminal meanwhile is left out.
    """
    disabled = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except Exception as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise RecordError(
            str(path), [f"cannot be read as {kind}: {reason}."]
        ) from error
    finally:
        logging.disable(disabled)


def _checked(path: pathlib.Path, table: Table) -> Table:
    if not table.columns:
        raise RecordError(
            str(path),
            ["found no vector of numbers; objects such as tables cannot be read."],
        )
    return table


def _rate_in(properties: dict[Any, Any]) -> float | None:
    """Return the sampling rate [Hz] among named numbers, if it is there."""
    # With an exponent no sign of a number can be one between thousands.
    texts = {
        name: f"{value:.16e}" if isinstance(value, numbers.Real) else value
        for name, value in properties.items()
    }
    return header_rate([f"{name}: {text}" for name, text in texts.items()])


def _leaves(content: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values of nested structures with their dotted names."""
    if isinstance(content, dict):
        for key, value in content.items():
            yield from _leaves(value, f"{name}.{key}" if name else str(key))
    else:
        yield name, content


def _sibling_labels(name: str, leaves: dict[str, Any]) -> list[str] | None:
    """Return the first list of texts in the same structure, or None."""
    folder = name.rpartition(".")[0]
    for other, value in leaves.items():
        if np.asarray(value).dtype.kind in "fiubc":
            continue
        texts = np.asarray(value, dtype=object).ravel().tolist()
        is_texts = len(texts) > 1 and all(isinstance(text, str) for text in texts)
        if other.rpartition(".")[0] == folder and is_texts:
            return [str(text).strip() for text in texts]
    return None


def _matrix_columns(name: str, value: Any, labels: list[str] | None) -> list[Column]:
    """Return a vector or the channels of a matrix, samples along its longer side."""
    array = (
        np.squeeze(np.asarray(value)) if not isinstance(value, list) else np.empty(0)
    )
    if array.dtype.kind not in "fiumMc" or array.size < 2 or array.ndim > 2:
        return []
    if array.dtype.kind == "c":
        # A complex vector is a real and an imaginary one, named in reading order.
        parts = {"real": np.real(array), "imaginary": np.imag(array)}
        names = labels or [name]
        return [
            column
            for part, values in parts.items()
            for column in _matrix_columns(
                f"{name} {part}", values, [f"{label} {part}" for label in names]
            )
        ]
    if array.ndim == 1:
        return [_column(name, lambda: _numbers(array))]
    count, longer = sorted(array.shape)
    if array.shape[0] != longer:
        array = array.T
    if count > _MOST_COLUMNS:
        return []
    if labels is None or len(labels) != count:
        labels = [f"{name}:{place}" for place in range(1, count + 1)]
    return [
        _column(label, functools.partial(_numbers, array[:, place]))
        for place, label in enumerate(labels)
    ]


def _column(label: str, values: Callable[[], Float[np.ndarray, " sample"]]) -> Column:
    name, unit = split_unit(label, FORCE, TIME)
    return Column(name, unit, values)


def _numbers(values: Shaped[np.ndarray, " sample"]) -> Float[np.ndarray, " sample"]:
    """Return numbers or clock times [s] since the first as floating point."""
    if values.dtype.kind in "mM":
        return (values - values[0]) / np.timedelta64(1, "s")
    return np.asarray(values, dtype=np.float64)
