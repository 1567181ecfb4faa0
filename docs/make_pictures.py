"""Make the pictures of the README from the results of its first command.

Run `uv run python docs/make_pictures.py` in the root of the repository after that
command. Chromium must be installed: the view that turns is a still of the report.
"""

import pathlib
import shutil
import sys
import tempfile

from PIL import Image

ROOT = pathlib.Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from browser import browser  # noqa: E402

RESULTS = ROOT / "out" / "paper-correct"
# Window of the report [px]; the view is as wide as its text.
WIDTH, HEIGHT = 1000, 900
COLOURS = 255
# The view of the part with its colours, as the uncorrected program cuts it.
CHOOSE = """document.documentElement.style.overflow = "hidden";
document.querySelector("[data-case]").click();"""
BOX = """(() => {
  const [view, legend] = ["scene", "legend"].map((name) =>
    document.getElementById(name).getBoundingClientRect());
  return [view.x - 6, view.y + scrollY, view.width + 12, legend.bottom - view.y + 2];
})()"""


def write_small(source: pathlib.Path, target: pathlib.Path) -> None:
    """Write a picture with few colours, which is a third of its size."""
    image = Image.open(source).convert("RGB")
    image = image.quantize(COLOURS, dither=Image.Dither.NONE)
    image.save(target, optimize=True)
    print(f"{target.relative_to(ROOT)}: {target.stat().st_size // 1024} KiB")


def main(results: pathlib.Path) -> None:
    """Make the pictures.

    Args:
        results: Folder of results of `diffmill correct`.
    """
    docs = ROOT / "docs"
    write_small(results / "surface.png", docs / "surface.png")
    write_small(results / "paths.png", docs / "correction.png")
    folder = pathlib.Path(tempfile.mkdtemp())
    with browser(folder / "profile") as page:
        page.open((results / "report.html").resolve(), width=WIDTH, height=HEIGHT)
        page.value(CHOOSE)
        page.settle()
        page.screenshot(folder / "view.png", box=page.value(BOX))
        write_small(folder / "view.png", docs / "view.png")
    shutil.rmtree(folder)


if __name__ == "__main__":
    main(pathlib.Path(sys.argv[1]) if len(sys.argv) > 1 else RESULTS)
