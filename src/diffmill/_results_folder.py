"""A folder or a file of results: complete, or absent.

A folder is checked before anything is imported or computed. Both are filled under
another name, which is changed at the end.
"""

import contextlib
import itertools
import os
import pathlib
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple, TypeAlias

# Names of the files of the last run, so that `force` replaces those and no others.
_MANIFEST = "manifest.txt"
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
        beside = (base.with_name(f"{base.name}-{k}") for k in itertools.count(2))
        return next(at for at in beside if is_free(at))

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
        with self._filled(fill) as temporary:
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
            self._take(temporary, names)

    def has_place_for(self, name: str) -> bool:
        """Return whether a file of that name lies directly in the folder."""
        return (self.path / name).parent == self.path and name not in ("", ".", "..")

    @contextlib.contextmanager
    def _filled(self, fill: Fill) -> Iterator[pathlib.Path]:
        """Yield a temporary sibling of the folder, filled; remove what is left."""
        folder = self.path
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

    def _publish(self, temporary: pathlib.Path) -> None:
        """Give the finished folder its name; replace earlier results."""
        folder, names = self.path, {p.name for p in temporary.iterdir()}
        if folder.is_dir() and any(folder.iterdir()):
            self._clear()
            self._take(temporary, names)
            return
        _write_manifest(temporary, names)
        # A temporary folder is private to its owner; a result is like any other folder.
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o777 & ~mask)
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


def write_whole(file: pathlib.Path, content: bytes | memoryview) -> None:
    """Write a file, all of it or nothing; replace one that is there.

    Args:
        file: The file.
        content: What it is to hold.

    Raises:
        OSError: It cannot be written; the error names it.
    """
    part = file.with_name(f".{file.name}.{os.getpid()}")
    try:
        part.write_bytes(content)
        os.replace(part, file)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(file)) from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink()
