"""Copying an example to where a user wants it."""

import os
import pathlib
from importlib import resources

EXAMPLES = {
    "tiny": "one slot on a soft machine given by its modes: a first look",
    "paper_small": "steps and pockets on an arm, in a quarter of the time of `paper`",
    "paper": "the test part of the published experiment, on an arm of six joints",
    "measured_slot": "measured mean forces, for `diffmill identify`",
}


def _files(name: str) -> dict[str, str]:
    """Return the files of an example by name.

    Args:
        name: One of `EXAMPLES`.

    Returns:
        The text of each file: the job first, then its program if it has one.

    Raises:
        ValueError: There is no such example.
    """
    if name not in EXAMPLES:
        allowed = ", ".join(EXAMPLES)
        raise ValueError(f"example: found {name!r}; allowed: {allowed}")
    folder = resources.files("diffmill.examples")
    files = [folder.joinpath(name + suffix) for suffix in (".toml", ".ngc")]
    return {f.name: f.read_text(encoding="utf-8") for f in files if f.is_file()}


def copy_example(
    name: str, folder: str | os.PathLike[str] = ".", *, force: bool = False
) -> pathlib.Path:
    """Write the files of an example to a folder.

    Args:
        name: One of `EXAMPLES`.
        folder: Folder of the files; it is made if absent.
        force: True to overwrite files of the same name.

    Returns:
        Path of the job file.

    Raises:
        ValueError: There is no such example, or files of its names exist.
    """
    files = _files(name)
    target = pathlib.Path(folder)
    existing = [n for n in files if (target / n).exists()]
    if existing and not force:
        raise ValueError(
            f"example: found {', '.join(existing)} in {target}; a folder without "
            "them is required, or --force, which overwrites them"
        )
    target.mkdir(parents=True, exist_ok=True)
    for file, text in files.items():
        (target / file).write_text(text, encoding="utf-8", newline="\n")
    return target / next(iter(files))
