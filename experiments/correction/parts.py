"""Small parts that ask different things of a correction, as G-code.

A wall between a roughing and a finishing pass on either side, a spiral pocket without a
corner, and a wavy surface under a ball end mill, beside the part of the examples. Sizes
are in millimetres and are chosen here.

python experiments/correction/parts.py [FOLDER]
"""

import itertools
import math
import pathlib
import sys
import tempfile
from dataclasses import dataclass

from diffmill import examples

RADIUS = 5.0  # of the tool, which the sizes below are made for
DEPTH = 1.0
FEED = 3000
CLEARANCE = 1.0
# Straight way outside the block in which the feed is reached at 0.5 m/s^2.
APPROACH = 3.0


@dataclass(frozen=True)
class Part:
    """A block, its program and the tool.

    Attributes:
        name: Name of the part.
        cutter: "flat" or "ball".
        lower: Lower corner of the block [mm].
        upper: Upper corner of the block [mm].
        program: G-code.
    """

    name: str
    cutter: str
    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    program: str


def paper_small() -> Part:
    """Return the part of the example of that name."""
    with tempfile.TemporaryDirectory() as folder:
        job = examples.copy_example("paper_small", folder)
        text = job.with_suffix(".ngc").read_text(encoding="utf-8")
    return Part("paper_small", "flat", (0, 0, -6), (42, 17, 0), text)


def thin_wall(*, length: float = 24, thickness: float = 3, finish: float = 0.5) -> Part:
    """Return a wall along x: each side is roughed, and finished by a second pass."""
    start, end = -RADIUS - APPROACH, length + RADIUS + APPROACH
    lines = []
    for allowance in (finish, 0.0):
        y = thickness / 2 + allowance + RADIUS
        # Up one side and down the other: both walls are on the right of the tool.
        for x, x_end, side in ((start, end, 1), (end, start, -1)):
            lines += [
                f"({'finishing' if allowance == 0 else 'roughing'} pass)",
                f"G0 X{x:g} Y{side * y:g}",
                f"G0 Z{-DEPTH:g}",
                f"G1 X{x_end:g} F{FEED}",
                f"G0 Z{CLEARANCE:g}",
            ]
    half = thickness / 2 + 3
    return _part("thin_wall", "flat", (0, -half, -3), (length, half, 0), lines)


def spiral_pocket(*, diameter: float = 22, entry: float = 1.8) -> Part:
    """Return a round pocket: down a helix, out by half turns, once around the wall."""
    wall = diameter / 2 - RADIUS
    turns = math.ceil((wall - entry) / 1.5)
    radii = [entry + (wall - entry) * k / turns for k in range(turns + 1)]
    lines = [
        "(spiral pocket)",
        f"G0 X{entry:g} Y0",
        f"G1 Z0 F{FEED}",
        f"G3 X{entry:g} Y0 Z{-DEPTH:g} I{-entry:g} J0",
        f"G3 X{entry:g} Y0 I{-entry:g} J0",
    ]
    side = 1
    for r, next_r in itertools.pairwise(radii):
        side = -side
        lines.append(f"G3 X{side * next_r:.4f} Y0 R{(r + next_r) / 2:.4f}")
    lines += [
        f"G3 X{side * wall:.4f} Y0 I{-side * wall:.4f} J0",
        f"G0 Z{CLEARANCE:g}",
    ]
    half = diameter / 2 + 3
    return _part("spiral_pocket", "flat", (-half, -half, -4), (half, half, 0), lines)


def freeform(*, length: float = 24, passes: int = 4, step_over: float = 1.5) -> Part:
    """Return a wavy surface, cut to and fro by the tip of a ball end mill."""
    start, end, piece = -APPROACH - 2, length + APPROACH + 2, 0.5
    count = round((end - start) / piece)
    lines = [f"G0 X{start:g} Y0", f"G0 Z{_wave(start, 0):.4f}"]
    for k in range(passes):
        y = k * step_over
        places = [start + (end - start) * i / count for i in range(count + 1)]
        places = places[::-1] if k % 2 else places
        lines.append(f"G1 Y{y:g} Z{_wave(places[0], y):.4f} F{FEED}")
        lines += [f"G1 X{x:.4f} Z{_wave(x, y):.4f}" for x in places[1:]]
    lines.append(f"G0 Z{CLEARANCE + 1:g}")
    top = (passes - 1) * step_over + 2
    return _part("freeform", "ball", (0, -2, -4), (length, top, 0), lines)


def _wave(x: float, y: float) -> float:
    """Return the height of the tip: radii of curvature far above the tool's.

    So shallow, since the first pass is a full slot, in which the softer arm chatters
    where it is deeper.
    """
    along, across = 2 * math.pi * x / 24, 2 * math.pi * y / 12
    return -0.25 - 0.12 * math.sin(along) - 0.05 * math.cos(across)


def _part(
    name: str,
    cutter: str,
    lower: tuple[float, float, float],
    upper: tuple[float, float, float],
    lines: list[str],
) -> Part:
    whole = ["%", "G21 G17 G90 G94", "T1 M6 S8000 M3", *lines, "M5", "M2", "%"]
    return Part(name, cutter, lower, upper, "\n".join(whole) + "\n")


PARTS = {
    make.__name__: make for make in (paper_small, thin_wall, spiral_pocket, freeform)
}


def main() -> None:
    """Write all programs."""
    folder = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    folder.mkdir(parents=True, exist_ok=True)
    for name, make in PARTS.items():
        file = folder / f"{name}.ngc"
        file.write_text(make().program, encoding="utf-8", newline="\n")
        print(f"wrote {file}")


if __name__ == "__main__":
    main()
