"""Stock and meshes on disk: the only module of this subpackage that touches files."""

import contextlib
import io
import logging
import os
import warnings
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

import jax
import jax.numpy as jnp
import numpy as np

from ._dexel.stock import Stock
from ._dexel.stock_arrays import arrays_of_stock, check_headers, stock_of_arrays
from ._mesh.from_mesh import stock_from_mesh
from ._mesh.mesh import Mesh, mesh_fault, vertex_fault, weld

# Unit of the numbers in a mesh file.
MeshUnit: TypeAlias = Literal["m", "cm", "mm", "um", "in"]
_METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 25.4e-3}
_SUFFIXES, _STOCK = (".stl", ".obj", ".ply"), ".npz"


# Share of a mesh's size within which corners are the same.
_SAME_CORNER = 1e-6
# Bytes of text, those beyond ASCII as question marks.
_ASCII = bytes(byte if byte < 128 else ord("?") for byte in range(256))
# A binary STL: its header, which ends in the number of triangles; a triangle [byte].
_STL_HEADER, _STL_TRIANGLE = 84, 50


class StockFileError(ValueError):
    """Raise when a file has no stock, or a mesh that bounds no solid."""


def load_mesh(path: str | os.PathLike[str], *, unit: MeshUnit = "mm") -> Mesh:
    """Closed mesh from a file.

    Nothing but the file itself is read: materials and textures that it names are not.

    Args:
        path: An STL, OBJ or PLY file.
        unit: Unit of the numbers in the file, which these formats do not state.

    Returns:
        The mesh in metres, equal vertices joined; where that leaves gaps, those within
        a millionth of its size too.

    Raises:
        StockFileError: The file cannot be read, or its triangles bound no solid.
        ValueError: The unit is unknown.

    Warns:
        UserWarning: Vertices that differ were joined.
    """
    scale, suffix = _scale(unit), _suffix(path)
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise StockFileError(f"{os.fspath(path)}: cannot be read: {error}") from error
    if fault := _count_fault(data, suffix):
        raise StockFileError(f"{os.fspath(path)}: {fault}")
    if suffix == ".obj" or _is_text_stl(data, suffix):
        # Names may be in any encoding, and say nothing here.
        data = data.translate(_ASCII)
    import trimesh

    try:
        # Bytes, not a name: without a place there is nothing beside it to follow.
        with _silenced(trimesh.util.log):
            raw: Any = trimesh.load_mesh(
                io.BytesIO(data),
                file_type=suffix[1:],
                process=False,
                skip_materials=True,
            )
        mesh = Mesh(
            np.asarray(raw.vertices, np.float64).reshape(-1, 3),
            np.asarray(raw.faces, np.int64).reshape(-1, 3),
        )
        fault = _index_fault(mesh)
    # A damaged file makes a parser raise anything.
    except Exception as error:
        raise StockFileError(
            f"{os.fspath(path)}: is no valid {suffix[1:].upper()} file: "
            f"{type(error).__name__}: {error}"
        ) from error
    if fault is None:
        exact = weld(Mesh(mesh.vertices * scale, mesh.faces))
        fault = mesh_fault(exact)
        if fault is not None and len(exact.vertices) and vertex_fault(exact) is None:
            size = float(np.ptp(exact.vertices, axis=0).max())
            mesh = weld(exact, _SAME_CORNER * size)
            joined = len(exact.vertices) - len(mesh.vertices)
            if joined and mesh_fault(mesh) is None:
                warnings.warn(
                    f"{os.fspath(path)}: {joined} corners of triangles within "
                    f"{_SAME_CORNER * size * 1e6:.3g} um of another one are joined "
                    "with it: without that the surface has gaps",
                    stacklevel=2,
                )
                exact, fault = mesh, None
        mesh = exact
    if fault is not None:
        raise StockFileError(f"{os.fspath(path)}: {fault}")
    return mesh


def from_mesh(
    path_or_mesh: str | os.PathLike[str] | Mesh,
    spacing: float,
    *,
    unit: MeshUnit = "mm",
    interval_counts: Sequence[int] | None = None,
    dtype: type | jnp.dtype | None = None,
) -> Stock:
    """Stock of the solid that a closed mesh bounds, in its place.

    Args:
        path_or_mesh: An STL, OBJ or PLY file, or a mesh; a closed surface, all
            triangles facing outward; shells may overlap.
        spacing: Distance between rays [m].
        unit: Unit of the numbers in a file, which these formats do not state.
        interval_counts: Slots for intervals of a ray along x, y and z; by default as
            many as the part needs and seven more along x and y.
        dtype: Floating type; JAX's default if not given.

    Returns:
        The stock; the ends of its rays lie on the triangles. Its grid is the one that
        `box` gives the box around the part.

    Raises:
        StockFileError: The file cannot be read, or its triangles bound no solid.
        ValueError: An argument is out of range, a mesh that is no file bounds no solid,
            the slots are too few, or the stock is larger than half of the physical
            memory.
    """
    if isinstance(path_or_mesh, Mesh):
        mesh = path_or_mesh
        if fault := _index_fault(mesh) or mesh_fault(mesh):
            raise ValueError(f"Argument `path_or_mesh` must bound a solid: {fault}.")
        return stock_from_mesh(
            mesh, spacing, interval_counts=interval_counts, dtype=dtype
        )
    mesh = load_mesh(path_or_mesh, unit=unit)
    try:
        return stock_from_mesh(
            mesh, spacing, interval_counts=interval_counts, dtype=dtype
        )
    except ValueError as error:
        raise StockFileError(f"{os.fspath(path_or_mesh)}: {error}") from error


def save(
    stock_or_mesh: Stock | Mesh,
    path: str | os.PathLike[str],
    *,
    unit: MeshUnit = "mm",
) -> None:
    """Write a stock as it is, or the surface of a stock, or a mesh, to a file.

    Args:
        stock_or_mesh: The stock or mesh.
        path: The file. Its suffix chooses: .npz takes a stock as plain arrays (no
            pickle) in metres, for each axis f of x, y and z the array `ends_f` (u, v,
            2, slot) and the array `poses_f` of the same shape, and `origin`,
            `spacing`, `top`, `volume_weights`; .stl (binary), .obj and .ply take the
            surface.
        unit: Unit of the numbers of a surface. STL rounds them to single precision.

    Raises:
        StockFileError: The suffix is none of these, or a mesh is to be an .npz file.
        ValueError: The stock has no material, or the unit is unknown.
        OSError: The file cannot be written.
    """
    is_stock = isinstance(stock_or_mesh, Stock)
    if is_stock and Path(path).suffix.lower() == _STOCK:
        with open(path, "wb") as file:
            arrays = arrays_of_stock(stock_or_mesh)
            np.savez_compressed(file, allow_pickle=False, **arrays)
        return
    others = (_STOCK,) if is_stock else ()
    scale, suffix = _scale(unit), _suffix(path, *others)
    mesh = stock_or_mesh.to_mesh() if is_stock else stock_or_mesh
    import trimesh

    out = trimesh.Trimesh(mesh.vertices / scale, mesh.faces, process=False)
    options: dict[str, Any] = {"digits": 12} if suffix == ".obj" else {}
    data: Any = out.export(file_type=suffix[1:], **options)
    Path(path).write_bytes(data.encode("utf-8") if isinstance(data, str) else data)


def load_stock(
    path: str | os.PathLike[str],
    *,
    is_raw: bool = True,
    dtype: type | jnp.dtype | None = None,
) -> Stock:
    """Stock that `save` or a run wrote (`stock.npz`).

    Args:
        path: The .npz file.
        is_raw: True for raw stock of another run: its ends forget the poses that cut
            them, which mean nothing to another path, and its top is the highest
            remaining material. False for the stock as it was saved.
        dtype: Floating type; JAX's default if not given.

    Returns:
        The stock.

    Raises:
        StockFileError: The file cannot be read, is damaged or of another format.
    """
    name = os.fspath(path)
    try:
        with zipfile.ZipFile(path) as archive:
            check_headers(_headers(archive))
        with np.load(path, allow_pickle=False) as archive:
            arrays = {key: archive[key] for key in archive.files}
        return stock_of_arrays(arrays, is_raw=is_raw, dtype=dtype)
    except OSError as error:
        raise StockFileError(f"{name}: cannot be read: {error}") from error
    except zipfile.BadZipFile as error:
        raise StockFileError(f"{name}: is no undamaged .npz file: {error}") from error
    # A damaged archive makes the reader raise anything.
    except Exception as error:
        raise StockFileError(f"{name}: holds no stock: {error}") from error


def _is_text_stl(data: bytes, suffix: str) -> bool:
    """True if the data is an STL in text; a binary one may begin with solid too."""
    is_solid = data[:80].lstrip()[:5].lower() == b"solid"
    return suffix == ".stl" and is_solid and b"facet" in data[:2000].lower()


def _count_fault(data: bytes, suffix: str) -> str | None:
    """Fault of the number of triangles of a binary STL; None if there is none."""
    if suffix != ".stl" or _is_text_stl(data, suffix) or len(data) < _STL_HEADER:
        return None
    count = int.from_bytes(data[_STL_HEADER - 4 : _STL_HEADER], "little")
    whole, more = divmod(len(data) - _STL_HEADER, _STL_TRIANGLE)
    if count == whole:
        return None
    surplus = f" and {more} bytes" * (more > 0)
    return (
        f"the header of the binary STL counts {count} triangles, but {whole}{surplus} "
        "follow: the file is cut off, or its writer left the count out"
    )


@contextlib.contextmanager
def _silenced(log: logging.Logger) -> Iterator[None]:
    """Let a library not print the tracebacks of what it tried."""
    before, log.disabled = log.disabled, True
    try:
        yield
    finally:
        log.disabled = before


def _headers(archive: zipfile.ZipFile) -> dict[str, jax.ShapeDtypeStruct]:
    """Shape and type of each array of an archive, whose numbers are not read."""
    headers = {}
    for entry in archive.infolist():
        with archive.open(entry) as file:
            version = np.lib.format.read_magic(file)
            if version != (1, 0):
                raise ValueError(f"array {entry.filename!r} is of format {version}")
            shape, _, dtype = np.lib.format.read_array_header_1_0(file)
        name = entry.filename.removesuffix(".npy")
        headers[name] = jax.ShapeDtypeStruct(shape, dtype)
    return headers


def _index_fault(mesh: Mesh) -> str | None:
    if len(mesh.faces) and not (
        mesh.faces.min() >= 0 and mesh.faces.max() < len(mesh.vertices)
    ):
        return "found triangles with vertices that do not exist"
    if not len(mesh.faces):
        return "found no triangles"
    return None


def _scale(unit: str) -> float:
    if unit not in _METRES:
        allowed = ", ".join(get_args(MeshUnit))
        raise ValueError(f"Argument `unit` must be one of {allowed}, but is {unit!r}.")
    return _METRES[unit]


def _suffix(path: str | os.PathLike[str], *others: str) -> str:
    """Suffix of a mesh file; a refusal names `others` as allowed, too."""
    suffix = Path(path).suffix.lower()
    if suffix not in _SUFFIXES:
        raise StockFileError(
            f"{os.fspath(path)}: found the suffix {suffix!r}; allowed: "
            f"{', '.join((*others, *_SUFFIXES))}"
        )
    return suffix
