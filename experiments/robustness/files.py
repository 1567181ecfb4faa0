"""What the program says of every file in a folder: one row for each.

python experiments/robustness/files.py FOLDER [--words 30]

Programs, jobs, records and recorded paths are checked, robots printed, meshes read. The
row has the exit code (0 read, 2 refused), and what was said that is not plain facts:
notes, or the faults. A job that identifies something is checked likewise.
"""

import argparse
import contextlib
import io
import pathlib
import re
import tempfile
import traceback
import warnings

import jax

jax.config.update("jax_enable_x64", True)

from diffmill import cli, workpiece  # noqa: E402

MESHES, ROBOTS = {".stl", ".obj", ".ply"}, {".urdf", ".xml"}
OTHERS = {".md", ".py", ".dat"}


def told(file: pathlib.Path, folder: pathlib.Path) -> tuple[int, str]:
    """Return the exit code of the command for a file, and what it says.

    Args:
        file: The file.
        folder: Where the command may write what it draws.
    """
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        if file.suffix.lower() in MESHES:
            code = _mesh(file)
        else:
            words = ["check", str(file)]
            if file.suffix.lower() in ROBOTS:
                words = ["robot", str(file), "--out", str(folder), "--force"]
            try:
                code = cli.main(words)
            except SystemExit as end:
                code = int(end.code or 0)
            except Exception:
                code = 3
                print(f"note: ESCAPE {traceback.format_exc(limit=-1)}")
    return code, out.getvalue()


def _mesh(file: pathlib.Path) -> int:
    """Say what a mesh is, or why it is none."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        try:
            workpiece.from_mesh(file, 1e-3)
        except workpiece.StockFileError as error:
            print(f"error: {error}")
            return 2
    for item in found:
        print(f"note: {item.message}")
    return 0


def main() -> None:
    """Print a row for every file."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--words", type=int, default=30, help="of what is said")
    asked = parser.parse_args()
    files = [x for x in sorted(asked.folder.rglob("*")) if x.is_file()]
    with tempfile.TemporaryDirectory() as folder:
        for file in files:
            if file.suffix.lower() in OTHERS:
                continue
            code, text = told(file, pathlib.Path(folder, "robot"))
            said = _telling(text).replace(str(asked.folder), ".").split()
            short = " ".join(said[: asked.words]) + " ..." * (len(said) > asked.words)
            print(
                f"| {file.relative_to(asked.folder)} | {code} | {short} |", flush=True
            )


def _telling(text: str) -> str:
    """Return the notes and faults of what is said, or its first line."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    # Faults of a list begin with a dash.
    found = [x for x in lines if re.match(r"(note|warning|error|-)", x)]
    return " / ".join(found or lines[:1])


if __name__ == "__main__":
    main()
