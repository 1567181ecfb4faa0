"""Results on disk: a folder that is complete, or absent, or says that it is not."""

import contextlib
import os
import pathlib
import platform
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib import metadata
from typing import Any, TypeAlias

import numpy as np

from .._results_folder import check_folder
from ..workpiece import Stock, save_stock

# xarray takes half a second to import, which only these functions need.
Dataset: TypeAlias = Any
Content: TypeAlias = str | bytes | Callable[[pathlib.Path], object]

# Names of the files of the last run, so that `force` replaces those and no others.
_MANIFEST = "manifest.txt"
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
    "motor_positions": "rad",
    "joint_positions": "rad",
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
        dataset: What becomes `result.nc`; units and versions are added where absent.
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
        # By way of memory: HDF5 ends the process where it finds the disk full.
        content = described(dataset).to_netcdf(engine="h5netcdf")
        (folder / "result.nc").write_bytes(content)
        if stock is not None:
            save_stock(stock, folder / "stock.npz")
        for name, content in (files or {}).items():
            _write(folder, name, content)
        if fill is not None:
            fill(folder)

    return write_folder(out, fill_all, force=force)


def write_folder(
    out: str | os.PathLike[str],
    fill: Callable[[pathlib.Path], object],
    *,
    force: bool = False,
) -> pathlib.Path:
    """Write a folder of files, all of them or nothing.

    Args:
        out: The folder.
        fill: Called with a temporary folder, to write any number of files to.
        force: Whether to replace the results in a folder that is not empty; files
            that no earlier run wrote stay.

    Returns:
        The folder.

    Raises:
        ResultsError: If the folder is not empty, or cannot be written to.
    """
    check_folder(out, force=force)
    folder = pathlib.Path(os.path.realpath(out))
    folder.parent.mkdir(parents=True, exist_ok=True)
    with _filled(folder, fill) as temporary:
        _publish(temporary, folder)
    return folder


def extend_results(
    out: str | os.PathLike[str], fill: Callable[[pathlib.Path], object]
) -> None:
    """Add files to a folder of results, or replace some; all of them or nothing.

    Args:
        out: The folder, as `write_results` left it.
        fill: Called with a temporary folder, to write any number of files to.

    Raises:
        OSError: The files cannot be written.
    """
    folder = pathlib.Path(os.path.realpath(out))
    with _filled(folder, fill) as temporary:
        names = {p.name for p in temporary.iterdir()} | set(_manifest(folder))
        _move_into(folder, temporary, names)


@contextlib.contextmanager
def _filled(
    folder: pathlib.Path, fill: Callable[[pathlib.Path], object]
) -> Iterator[pathlib.Path]:
    """Yield a temporary sibling of a folder, filled; remove what is left of it."""
    made = tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent)
    temporary = pathlib.Path(made)
    try:
        try:
            fill(temporary)
        except OSError as error:
            if error.filename is None:
                error.filename = str(folder)
            raise
        yield temporary
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


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
    """Return what an aborted run has computed, with why and where it stopped.

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


def _write(folder: pathlib.Path, name: str, content: Content) -> None:
    """Write one further file."""
    target = folder / name
    if not _is_plain(folder, name):
        raise ValueError(f"File `{name}` must lie directly in the folder.")
    if callable(content):
        content(target)
    elif isinstance(content, bytes):
        target.write_bytes(content)
    else:
        target.write_text(content, encoding="utf-8", newline="\n")


def _publish(temporary: pathlib.Path, folder: pathlib.Path) -> None:
    """Give the finished folder its name; replace earlier results."""
    names = {p.name for p in temporary.iterdir()}
    if folder.is_dir() and any(folder.iterdir()):
        _clear(folder)
        _move_into(folder, temporary, names)
        return
    _write_manifest(temporary, names)
    # A temporary folder is private to its owner; a result is like any other folder.
    mask = os.umask(0)
    os.umask(mask)
    temporary.chmod(0o777 & ~mask)
    if folder.is_dir():
        folder.rmdir()
    os.rename(temporary, folder)


def _move_into(
    folder: pathlib.Path, temporary: pathlib.Path, names: Iterable[str]
) -> None:
    """Move the files of a temporary folder; the manifest, first, has the names."""
    moved = sorted(p.name for p in temporary.iterdir())
    _write_manifest(temporary, names)
    for name in [_MANIFEST, *moved]:
        target = folder / name
        if target.is_dir() and not target.is_symlink():
            shutil.rmtree(target)
        os.replace(temporary / name, target)


def _write_manifest(folder: pathlib.Path, names: Iterable[str]) -> None:
    (folder / _MANIFEST).write_text("\n".join(sorted({*names, _MANIFEST})) + "\n")


def _manifest(folder: pathlib.Path) -> list[str]:
    """Return the names of the files of the run before, as its manifest tells."""
    try:
        names = (folder / _MANIFEST).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return []
    # A manifest is only text: it must not reach outside its folder.
    return [name for name in names if _is_plain(folder, name)]


def _is_plain(folder: pathlib.Path, name: str) -> bool:
    return (folder / name).parent == folder and name not in ("", ".", "..")


def _clear(folder: pathlib.Path) -> None:
    """Remove the results of the run before."""
    for name in _manifest(folder):
        target = folder / name
        if target.is_dir() and not target.is_symlink():
            shutil.rmtree(target)
        else:
            target.unlink(missing_ok=True)
