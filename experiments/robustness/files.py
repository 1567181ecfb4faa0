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
import traceback
import warnings

import jax

jax.config.update("jax_enable_x64", True)

from diffmill import cli, workpiece  # noqa: E402

MESHES, ROBOTS = {".stl", ".obj", ".ply"}, {".urdf", ".xml"}
OTHERS = {".md", ".py", ".dat"}


def told(file: pathlib.Path) -> tuple[int, str]:
    """Return the exit code of the command for a file, and what it says."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        if file.suffix.lower() in MESHES:
            code = _mesh(file)
        else:
            command = "robot" if file.suffix.lower() in ROBOTS else "check"
            try:
                code = cli.main([command, str(file)])
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
    for file in sorted(asked.folder.rglob("*")):
        if not file.is_file() or file.suffix.lower() in OTHERS:
            continue
        code, text = told(file)
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        telling = [x for x in lines if re.match(r"(note|warning|error|ESCAPE|-)", x)]
        said = " / ".join(telling or lines[:1]).replace(str(asked.folder), ".")
        words = said.split()
        short = " ".join(words[: asked.words]) + (" ..." * (len(words) > asked.words))
        print(f"| {file.relative_to(asked.folder)} | {code} | {short} |", flush=True)


if __name__ == "__main__":
    main()
