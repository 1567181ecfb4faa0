"""Copying an example to where a user wants it."""

import os
import pathlib
from importlib import resources

# Jobs with their programs.
EXAMPLES = ("paper", "paper_small")
# Measurements for `diffmill identify`.
MEASUREMENTS = ("measured_slot",)


def example_files(name: str) -> dict[str, str]:
    """Return the files of an example by name.

    Args:
        name: One of `EXAMPLES` or `MEASUREMENTS`.

    Returns:
        The text of each file: the job first, then its program if it has one.

    Raises:
        ValueError: There is no such example.
    """
    if name not in (*EXAMPLES, *MEASUREMENTS):
        allowed = ", ".join((*EXAMPLES, *MEASUREMENTS))
        raise ValueError(f"example: found {name!r}; allowed: {allowed}")
    folder = resources.files("diffmill.examples")
    names = [f"{name}.toml"] + [f"{name}.ngc"] * (name in EXAMPLES)
    return {n: folder.joinpath(n).read_text(encoding="utf-8") for n in names}


def copy_example(
    name: str, folder: str | os.PathLike[str] = ".", *, force: bool = False
) -> pathlib.Path:
    """Write the files of an example to a folder.

    Args:
        name: One of `EXAMPLES` or `MEASUREMENTS`.
        folder: Where to write; it is made if absent.
        force: Whether files of the same name are overwritten.

    Returns:
        Path of the job file.

    Raises:
        ValueError: There is no such example, or files of its names exist.
    """
    files = example_files(name)
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
