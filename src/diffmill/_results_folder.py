"""A folder for results, checked before anything is imported or computed."""

import os
import pathlib
import tempfile


class ResultsError(ValueError):
    """Raise when results cannot go to the folder that was named."""


def check_folder(out: str | os.PathLike[str], *, force: bool = False) -> None:
    """Raise if results could not be written to a folder; write nothing.

    Args:
        out: The folder, which need not exist.
        force: Whether a folder with something in it is allowed.

    Raises:
        ResultsError: If it is a file, has something in it, or cannot be written.
    """
    folder = pathlib.Path(os.path.realpath(out))
    if folder.exists() and not folder.is_dir():
        raise ResultsError(f"--out {out}: found a file; a folder is required")
    if folder.is_dir() and any(folder.iterdir()) and not force:
        raise ResultsError(
            f"--out {out}: found a folder that is not empty; an empty or new one is "
            "required, or --force, which replaces the results in it"
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
