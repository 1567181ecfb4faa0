"""Checkpoints: what a long run needs to go on, in a file that is whole or refused.

A first line holds the version of the format and the SHA-256 of it and of all that
follows, an `.npz` archive of plain arrays (no pickle). A new checkpoint is written
beside the old one, flushed to the disk and renamed; the one before is kept. So a run
that is killed at any moment leaves at least one that is whole.

What a run adds once and never changes, such as the rows of a long path, lies in parts
beside it: archives in a folder, each under its own SHA-256, which the checkpoint lists.
So a checkpoint does not grow with what has been computed.
"""

import dataclasses
import hashlib
import io
import pathlib
import shutil
import zipfile
from collections.abc import Iterator, Mapping
from importlib import metadata
from typing import Any, NamedTuple

import numpy as np

from .._arrays import Arrays
from .._results_folder import parts_of, previous_of, write_whole

_MAGIC, _VERSION = b"diffmill-checkpoint", 5
# Longest first line that is looked at.
_LONGEST_FIRST_LINE = 200
# Names that the file adds to the arrays, which themselves never begin with a dot.
_JOB, _MADE_BY, _PARTS = ".job", ".made_by", ".parts"
_PACKAGES = (
    "diffmill",
    "jax",
    "jaxlib",
    "equinox",
    "numpy",
    "scipy",
    "optax",
    "clarabel",
)


class CheckpointError(ValueError):
    """Raise when a checkpoint is damaged, or belongs to another job or version."""


class DamagedCheckpoint(CheckpointError):
    """Raise when a file is no whole checkpoint; the one before may be."""


class LatestCheckpoint(NamedTuple):
    """The newest checkpoint that is whole.

    Attributes:
        arrays: What it and its parts hold, by name; None if there is no checkpoint at
            all. Those of parts are read when they are asked for.
        notes: What was refused, one sentence each.
        parts: Names of its parts.
    """

    arrays: Arrays | None
    notes: tuple[str, ...]
    parts: tuple[str, ...] = ()


class CheckpointFile(NamedTuple):
    """A checkpoint and the one before it, under the suffix `.previous`.

    Attributes:
        path: The file.
        job_fingerprint: Of the job that it belongs to.
    """

    path: pathlib.Path
    job_fingerprint: str

    @classmethod
    def of_job(cls, path: pathlib.Path, job: object) -> "CheckpointFile":
        """Return the checkpoint of a job, known by every byte of every array in it.

        Args:
            path: The file.
            job: Modules, tuples, lists, dicts, arrays, numbers, text and functions in
                any nesting.

        Raises:
            TypeError: Something in it has no bytes that stand for it.
        """
        digest = hashlib.sha256()
        _feed(digest, job)
        return cls(path, digest.hexdigest())

    @property
    def previous(self) -> pathlib.Path:
        """The file that holds the checkpoint before."""
        return previous_of(self.path)

    def exists(self) -> bool:
        """True if a checkpoint, or the one before it, is there."""
        return self.path.exists() or self.previous.exists()

    def remove(self) -> None:
        """Remove the checkpoint, the one before it and their parts, if there are any.

        Parts go last: without them a checkpoint is refused.
        """
        self.previous.unlink(missing_ok=True)
        self.path.unlink(missing_ok=True)
        shutil.rmtree(parts_of(self.path), ignore_errors=True)

    def add_part(self, arrays: Arrays) -> str:
        """Write a part, which no checkpoint lists so far; return its name.

        Args:
            arrays: Plain arrays by name.

        Raises:
            OSError: The part cannot be written.
        """
        content = _archive(arrays)
        name, folder = hashlib.sha256(content).hexdigest(), parts_of(self.path)
        folder.mkdir(exist_ok=True)
        write_whole(folder / name, content)
        return name

    def write(self, arrays: Arrays, parts: tuple[str, ...] = ()) -> None:
        """Write a checkpoint, and keep the one before.

        Args:
            arrays: Plain arrays by name.
            parts: Names of the parts that belong to it.

        Raises:
            OSError: The file cannot be written; the earlier ones are as they were.
        """
        if wrong := [name for name in arrays if name.startswith(".")]:
            raise ValueError(f"Argument `arrays` must have no name as {wrong[0]!r}.")
        all_arrays = {name: np.asarray(value) for name, value in arrays.items()}
        all_arrays[_JOB] = np.asarray(self.job_fingerprint)
        all_arrays[_MADE_BY] = np.asarray(_versions())
        all_arrays[_PARTS] = np.array(parts, np.str_)
        version, content = b"%d" % _VERSION, _archive(all_arrays)
        first = b"%s %s %s\n" % (_MAGIC, version, _digest(version, content))
        previous = self.previous
        try:
            _arrays_of(self.path)
        except (OSError, CheckpointError):
            # A damaged one must not take the place of the whole one that the run went
            # on from.
            previous = None
        write_whole(self.path, first + content, previous=previous)

    def latest(self) -> "LatestCheckpoint":
        """Return the newest checkpoint that is whole.

        Raises:
            DamagedCheckpoint: There are checkpoints, but none is whole with its parts.
            CheckpointError: It is of another job, format or version of the programs.
        """
        notes: list[str] = []
        for file in (self.path, self.previous):
            if not file.exists():
                continue
            try:
                arrays, parts = self._read(file)
            except DamagedCheckpoint as error:
                notes.append(str(error))
                continue
            if notes:
                notes.append(f"the checkpoint before it is used: {file}")
            return LatestCheckpoint(arrays, tuple(notes), parts)
        if notes:
            raise DamagedCheckpoint("; ".join([*notes, "no other checkpoint is there"]))
        return LatestCheckpoint(None, ())

    def _read(self, file: pathlib.Path) -> tuple[Arrays, tuple[str, ...]]:
        """Arrays of one file, and its parts, if they are whole and of this job."""
        arrays = _arrays_of(file)
        made_by, job = str(arrays.pop(_MADE_BY)), str(arrays.pop(_JOB))
        parts = tuple(map(str, arrays.pop(_PARTS)))
        if made_by != _versions():
            raise CheckpointError(
                f"{file}: found a checkpoint made by {made_by}; only one made by "
                f"{_versions()} goes on to the same result"
            )
        if job != self.job_fingerprint:
            raise CheckpointError(
                f"{file}: found a checkpoint of another job or command; the job and "
                "all files that it names must be as they were when the run was started"
            )
        return _WithParts(arrays, parts_of(self.path), parts), parts


class _WithParts(Mapping[str, np.ndarray]):
    """Arrays of a checkpoint and of its parts, of which it holds the names alone."""

    def __init__(self, arrays: Arrays, folder: pathlib.Path, parts: tuple[str, ...]):
        self._arrays, self._files = arrays, dict[str, pathlib.Path]()
        for part in parts:
            file = folder / part
            try:
                with open(file, "rb") as stream:
                    digest = hashlib.file_digest(stream, "sha256").hexdigest()
            except FileNotFoundError as error:
                raise DamagedCheckpoint(f"{file}: found no such part") from error
            if digest != part:
                raise DamagedCheckpoint(f"{file}: is damaged: its content has changed")
            with np.load(file, allow_pickle=False) as archive:
                self._files |= dict.fromkeys(archive.files, file)

    def __getitem__(self, name: str) -> np.ndarray:
        """Array of that name."""
        if name in self._arrays:
            return self._arrays[name]
        with np.load(self._files[name], allow_pickle=False) as archive:
            return archive[name]

    def __iter__(self) -> Iterator[str]:
        """Names of all arrays."""
        return iter([*self._arrays, *self._files])

    def __len__(self) -> int:
        """Number of all arrays."""
        return len(self._arrays) + len(self._files)


def _archive(arrays: Arrays) -> bytes:
    """Archive of plain arrays."""
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def _digest(version: bytes, content: bytes) -> bytes:
    """Return the SHA-256 of version and content, as hexadecimal digits."""
    return hashlib.sha256(version + b"\n" + content).hexdigest().encode()


def _arrays_of(file: pathlib.Path) -> dict[str, np.ndarray]:
    """Return all arrays of a file whose bytes are as they were written."""
    with open(file, "rb") as stream:
        first = stream.readline(_LONGEST_FIRST_LINE)
        content = stream.read()
    words = first.split()
    if len(words) != 3 or words[0] != _MAGIC or not first.endswith(b"\n"):
        raise DamagedCheckpoint(f"{file}: is damaged: it does not begin as one does")
    if _digest(words[1], content) != words[2]:
        raise DamagedCheckpoint(f"{file}: is damaged: its content has changed")
    version = words[1].decode("ascii", "replace")
    if version != str(_VERSION):
        raise CheckpointError(
            f"{file}: found a checkpoint of format {version}; only format {_VERSION} "
            "is read"
        )
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise DamagedCheckpoint(f"{file}: is damaged: {error}") from error
    if not {_JOB, _MADE_BY, _PARTS} <= arrays.keys():
        raise DamagedCheckpoint(f"{file}: is damaged: it names no job")
    return arrays


def _versions() -> str:
    return ", ".join(f"{name} {metadata.version(name)}" for name in _PACKAGES)


def _feed(digest: Any, value: Any) -> None:
    """Feed a value to a digest; lengths and types keep neighbours apart."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        names = [field.name for field in dataclasses.fields(value)]
        digest.update(f"{type(value).__qualname__}:{len(names)};".encode())
        for name in names:
            digest.update(f"{name}=".encode())
            _feed(digest, getattr(value, name))
    elif isinstance(value, Mapping):
        digest.update(f"dict:{len(value)};".encode())
        for key in sorted(value):
            _feed(digest, key)
            _feed(digest, value[key])
    elif isinstance(value, tuple | list):
        digest.update(f"{type(value).__name__}:{len(value)};".encode())
        for item in value:
            _feed(digest, item)
    elif isinstance(value, str | bytes | bool | int | float | complex | type(None)):
        data = value if isinstance(value, bytes) else repr(value).encode()
        digest.update(f"{type(value).__name__}:{len(data)};".encode() + data)
    elif hasattr(value, "dtype") and hasattr(value, "shape"):
        array = np.asarray(value)
        digest.update(f"{array.dtype.str}{array.shape};".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    elif callable(value) and hasattr(value, "__qualname__"):
        digest.update(f"{value.__module__}.{value.__qualname__};".encode())
    else:
        raise TypeError(f"Argument `tree` holds {type(value)}, which has no bytes.")
