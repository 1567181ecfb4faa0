"""A folder or a file of results: complete, or absent.

A folder is checked before anything is imported or computed. Both are filled under
another name, which is changed at the end. That name begins with a digest of the final
one, so that it is short, and ends in letters that nobody can foresee. One run at a time
holds a lock beside its folder and removes the parts of runs that were killed.
"""

import contextlib
import errno
import hashlib
import io
import itertools
import os
import pathlib
import shutil
import signal
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

if TYPE_CHECKING:
    import xarray

try:
    import fcntl
except ImportError:
    # Windows has no locks of this kind.
    fcntl = None

# Names of the files of the last run, so that `force` replaces those and no others.
_MANIFEST = "manifest.txt"
_CHECKPOINT = ".checkpoint"
# Longest name of a file [bytes].
_NAME_MAX = 255
# How the names of all parts begin.
PART = ".diffmill-"
# What a file system answers that knows no locks.
_NO_LOCKS = (errno.ENOSYS, errno.ENOTSUP, errno.ENOLCK)
_WITHOUT_LOCKS = (
    "there are no locks on this file system, so that nothing hinders two runs from "
    "writing to one folder"
)
# Called with a temporary folder, to write any number of files to.
Fill: TypeAlias = Callable[[pathlib.Path], object]


class ResultsError(ValueError):
    """Raise when results cannot go to the folder that was named."""


class ResultsFolder(NamedTuple):
    """A folder for results, which need not exist.

    Attributes:
        path: Where it is, links followed.
        name: As the user wrote it.
    """

    path: pathlib.Path
    name: str = ""

    @classmethod
    def of(cls, out: str | os.PathLike[str]) -> "ResultsFolder":
        """Return the folder that a user names."""
        return cls(pathlib.Path(os.path.realpath(out)), os.fspath(out))

    def check(self, *, force: bool = False) -> None:
        """Raise if results could not be written; write nothing.

        Args:
            force: Whether a folder with something in it is allowed.

        Raises:
            ResultsError: If it is a file, has something in it, or cannot be written.
        """
        folder, out = self.path, self.name
        if folder.exists() and not folder.is_dir():
            raise ResultsError(f"--out {out}: found a file; a folder is required")
        if folder.is_dir() and any(folder.iterdir()) and not force:
            raise ResultsError(
                f"--out {out}: found a folder that is not empty; an empty or new one "
                "is required, or --force, which replaces the results in it"
            )
        parent = folder.parent
        while not parent.exists():
            parent = parent.parent
        try:
            with tempfile.TemporaryFile(dir=parent):
                pass
        except OSError as error:
            raise ResultsError(
                f"--out {out}: {parent} is no folder that can be written to: "
                f"{error.strerror}"
            ) from error

    def still_free(self, *, force: bool = False) -> pathlib.Path:
        """Return the folder, or one beside it if it has been filled since `check`.

        Args:
            force: As of `check`.
        """
        named = pathlib.Path(self.name)
        is_free = lambda at: not at.exists() or (at.is_dir() and not any(at.iterdir()))
        if is_free(named) or (force and named.is_dir()):
            return named
        # "." and ".." have no name of their own.
        base = self.path if named.name in ("", "..") else named
        beside = (sibling(base, f"-{k}") for k in itertools.count(2))
        return next(at for at in beside if is_free(at))

    @contextlib.contextmanager
    def locked(self) -> Iterator[str]:
        """Lock the folder against other runs; remove the parts that killed runs left.

        Folders above it that are made for the lock and stay empty are removed. Without
        a lock no part is removed, since it may be of a run that lives.

        Yields:
            A note where there are no locks, else an empty text.

        Raises:
            ResultsError: Another run holds the folder.
            OSError: No lock can be made.
        """
        above = [self.path.parent, *self.path.parent.parents]
        made = list(itertools.takewhile(lambda folder: not folder.exists(), above))
        self.path.parent.mkdir(parents=True, exist_ok=True)
        lock = self.lock
        try:
            with _locked(lock, self.name) as note:
                for path in (self.path, self.checkpoint):
                    if not note:
                        remove_parts(path.parent, _part_prefix(path), but=lock)
                yield note
        finally:
            with contextlib.suppress(OSError):
                for folder in made:
                    folder.rmdir()

    @property
    def lock(self) -> pathlib.Path:
        """The file beside the folder that a run locks."""
        return self.path.with_name(f"{_part_prefix(self.path)}lock")

    @property
    def version(self) -> tuple[int, int] | None:
        """Difference between two runs that wrote the folder; None before any."""
        with contextlib.suppress(OSError):
            found = (self.path / _MANIFEST).stat()
            return found.st_ino, found.st_mtime_ns
        return None

    @property
    def checkpoint(self) -> pathlib.Path:
        """The file beside the folder that keeps what an unfinished run has found."""
        return sibling(self.path, _CHECKPOINT)

    def checkpoints(self) -> list[pathlib.Path]:
        """Return the checkpoint and the one before it, those that are there."""
        names = (self.checkpoint, previous_of(self.checkpoint))
        return [file for file in names if file.exists()]

    def has_unfinished_run(self) -> bool:
        """True if the results are of a run that has not finished its figures."""
        return bool(self.checkpoints() and self._manifest())

    def write(self, fill: Fill, *, force: bool = False) -> None:
        """Write a folder of files, all of them or nothing.

        Args:
            fill: Writes the files.
            force: Whether to replace the results in a folder that is not empty; files
                that no earlier run wrote stay.

        Raises:
            ResultsError: If the folder is not empty, or cannot be written to.
        """
        self.check(force=force)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self._filled(fill) as temporary, _uninterrupted():
            self._publish(temporary)

    def extend(self, fill: Fill) -> None:
        """Add files to what `write` left, or replace some; all of them or nothing.

        Args:
            fill: Writes the files.

        Raises:
            OSError: The files cannot be written.
        """
        with self._filled(fill) as temporary:
            names = {p.name for p in temporary.iterdir()} | set(self._manifest())
            with _uninterrupted():
                self._take(temporary, names)

    def has_place_for(self, name: str) -> bool:
        """True if a file of that name lies directly in the folder."""
        return (self.path / name).parent == self.path and name not in ("", ".", "..")

    @contextlib.contextmanager
    def _filled(self, fill: Fill) -> Iterator[pathlib.Path]:
        """Yield a temporary sibling of the folder, filled; remove what is left."""
        folder = self.path
        made = tempfile.mkdtemp(prefix=_part_prefix(folder), dir=folder.parent)
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

    def _publish(self, temporary: pathlib.Path) -> None:
        """Give the finished folder its name; replace earlier results."""
        folder, names = self.path, {p.name for p in temporary.iterdir()}
        if folder.is_dir() and any(folder.iterdir()):
            self._clear()
            self._take(temporary, names)
            return
        _write_manifest(temporary, names)
        temporary.chmod(0o777 & ~_umask())
        if folder.is_dir():
            folder.rmdir()
        os.rename(temporary, folder)

    def _take(self, temporary: pathlib.Path, names: Iterable[str]) -> None:
        """Move the files of a temporary folder; the manifest, first, has the names."""
        moved = sorted(p.name for p in temporary.iterdir())
        _write_manifest(temporary, names)
        for name in [_MANIFEST, *moved]:
            target = self.path / name
            if target.is_dir() and not target.is_symlink():
                shutil.rmtree(target)
            os.replace(temporary / name, target)

    def _manifest(self) -> list[str]:
        """Return the names of the files of the run before, as its manifest tells."""
        try:
            names = (self.path / _MANIFEST).read_text(encoding="utf-8").splitlines()
        except (OSError, UnicodeDecodeError):
            return []
        # A manifest is only text: it must not reach outside its folder.
        return [name for name in names if self.has_place_for(name)]

    def _clear(self) -> None:
        """Remove the results of the run before."""
        for name in self._manifest():
            target = self.path / name
            if target.is_dir() and not target.is_symlink():
                shutil.rmtree(target)
            else:
                target.unlink(missing_ok=True)


def _write_manifest(folder: pathlib.Path, names: Iterable[str]) -> None:
    (folder / _MANIFEST).write_text("\n".join(sorted({*names, _MANIFEST})) + "\n")


def write_whole(
    file: pathlib.Path,
    content: bytes | memoryview,
    *,
    previous: pathlib.Path | None = None,
) -> None:
    """Write a file, all of it or nothing; replace one that is there.

    Args:
        file: The file.
        content: What it is to hold.
        previous: The name that the one before gets; None if it is not kept.

    Raises:
        OSError: It cannot be written; the error names it.
    """
    part = None
    try:
        handle, part = tempfile.mkstemp(prefix=_part_prefix(file), dir=file.parent)
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(handle)
        # A temporary file is private to its owner; a result is like any other file.
        os.chmod(part, 0o666 & ~_umask())
        with _uninterrupted():
            if previous is not None:
                # Another writer may have renamed it already.
                with contextlib.suppress(FileNotFoundError):
                    os.replace(file, previous)
            os.replace(part, file)
        _flush_folder(file.parent)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(file)) from error
    finally:
        if part is not None:
            with contextlib.suppress(OSError):
                os.unlink(part)


def netcdf_bytes(dataset: "xarray.Dataset") -> bytes:
    """Content of a netCDF file that holds a dataset.

    By way of memory: HDF5 ends the process where it finds the disk full. What
    `Dataset.to_netcdf` writes is the same, but it imports dask's scheduler first, where
    that is installed, to see whether this is one of its workers.
    """
    import h5netcdf
    from xarray.backends import H5NetCDFStore

    buffer = io.BytesIO()
    with h5netcdf.File(buffer, "w") as file:
        dataset.dump_to_store(H5NetCDFStore(file))
    return buffer.getvalue()


def previous_of(file: pathlib.Path) -> pathlib.Path:
    """Return the name that a file's earlier version is kept under."""
    return sibling(file, ".previous")


def parts_of(file: pathlib.Path) -> pathlib.Path:
    """Return the folder of the parts of a checkpoint."""
    return sibling(file, ".parts")


def sibling(path: pathlib.Path, suffix: str) -> pathlib.Path:
    """Return the path beside another one, whose name a suffix lengthens.

    A name that would be too long for a file system is cut, and a digest put in.

    Args:
        path: The other path.
        suffix: The suffix.
    """
    name, end = os.fsencode(path.name), os.fsencode(suffix)
    if len(name) + len(end) > _NAME_MAX:
        digest = f"-{_digest(path)}".encode()
        name = name[: _NAME_MAX - len(end) - len(digest)] + digest
    return path.with_name(os.fsdecode(name + end))


@contextlib.contextmanager
def _locked(lock: pathlib.Path, name: str) -> Iterator[str]:
    """Hold a lock, a file that stays empty; remove it afterwards."""
    if fcntl is None:
        yield _WITHOUT_LOCKS
        return
    while True:
        # A link is not followed: it may have been put there to harm another file.
        handle = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
        note = ""
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in _NO_LOCKS:
                note = _WITHOUT_LOCKS
            else:
                os.close(handle)
                if not isinstance(error, BlockingIOError):
                    raise
                raise ResultsError(
                    f"{name}: another run is writing there; wait for its end, or name "
                    "another place"
                ) from error
        # Who held it before may have removed it meanwhile.
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.stat(lock), os.fstat(handle)):
                break
        os.close(handle)
    try:
        yield note
    finally:
        lock.unlink(missing_ok=True)
        os.close(handle)


def _digest(path: pathlib.Path) -> str:
    return hashlib.sha256(os.fsencode(path.name)).hexdigest()[:12]


def _part_prefix(path: pathlib.Path) -> str:
    """Beginning of the names of the parts of a file or folder."""
    return f"{PART}{_digest(path)}-"


def remove_parts(
    folder: pathlib.Path, prefix: str = PART, *, but: pathlib.Path | None = None
) -> None:
    """Remove parts that killed runs left; only one who holds the lock may.

    Args:
        folder: Where they lie.
        prefix: How their names begin; of all parts if not given.
        but: The lock.
    """
    for part in folder.glob(f"{prefix}*"):
        if part.is_dir() and not part.is_symlink():
            shutil.rmtree(part, ignore_errors=True)
        elif part != but:
            part.unlink(missing_ok=True)


@contextlib.contextmanager
def _uninterrupted() -> Iterator[None]:
    """Put off interruptions until files have their final names."""
    came: list[int] = []
    handlers = {}
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            handlers[number] = signal.signal(number, lambda n, frame: came.append(n))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            # None stands for one that was not set from Python.
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        for number in came:
            signal.raise_signal(number)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _flush_folder(folder: pathlib.Path) -> None:
    """Make a rename last; not every system can open a folder."""
    if os.name == "nt":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
