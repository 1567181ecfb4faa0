"""Write the G-code of the example jobs: a test part with four features.

The part has the features of the paper's test part in its order (right rectangle,
square pocket, circular pocket, left rectangle). The paper gives no sizes; these are
chosen here. Run from anywhere: `python experiments/paper_part/generate.py [FOLDER]`.
"""

import pathlib
import sys
from dataclasses import dataclass

RADIUS = 5.0  # of the tool, which the sizes below are made for
DEPTH = 1.0
FEED = 3000
SPEED = 8000
CLEARANCE = 1.0


@dataclass(frozen=True)
class Part:
    """Sizes in millimetres; x and y from the lower left corner of the block.

    Attributes:
        name: Name of the example.
        width: Size of the block in x.
        height: Size of the block in y.
        step_width: Width of the steps at the right and left edge.
        step_height: Length of the steps along the edge.
        step_return: Distance of the way back from the way out; 0 leaves the block
            instead, for a step as narrow as the tool.
        square_x: Centre of the square pocket in x.
        square: Side of the square pocket.
        ramp_sides: Sides of the square over which the tool goes down.
        finish: Radial depth of its finishing cut, 0 for none.
        circle_x: Centre of the circular pocket in x.
        circle: Diameter of the circular pocket.
        helix: Diameter of the helix by which it is entered.
    """

    name: str
    width: float
    height: float
    step_width: float
    step_height: float
    step_return: float
    square_x: float
    square: float
    ramp_sides: int
    finish: float
    circle_x: float
    circle: float
    helix: float


PAPER = Part(
    name="paper",
    width=68,
    height=32,
    step_width=4,
    step_height=26,
    step_return=0,
    square_x=45,
    square=17,
    ramp_sides=4,
    finish=1.5,
    circle_x=21,
    circle=19,
    helix=6,
)
PAPER_SMALL = Part(
    name="paper_small",
    width=42,
    height=17,
    step_width=4,
    step_height=14,
    step_return=0,
    square_x=29,
    square=13.6,
    ramp_sides=2,
    finish=0,
    circle_x=13,
    circle=13.6,
    helix=3.6,
)


def number(value: float) -> str:
    """Return a number with up to three decimals, as people write it."""
    return f"{round(value, 3) + 0.0:g}"


def point(x: float, y: float, z: float | None = None) -> str:
    """Return the words of a point."""
    text = f"X{number(x)} Y{number(y)}"
    return text if z is None else f"{text} Z{number(z)}"


def step(part: Part, *, is_right: bool) -> list[str]:
    """Return the rectangle that mills a step into one edge, entered from outside."""
    side = 1 if is_right else -1
    edge = part.width if is_right else 0.0
    outside = edge + side * (RADIUS + 0.5)
    wall = edge - side * (part.step_width - RADIUS)
    back = wall + side * part.step_return
    low = (part.height - part.step_height) / 2 + RADIUS
    high = (part.height + part.step_height) / 2 - RADIUS
    if part.step_return > 0:
        leave = [f"G1 {point(back, high)}", f"G1 {point(back, low)}"]
    else:
        leave = [f"G1 {point(outside, high)}"]
    return [
        f"({'right' if is_right else 'left'} rectangle: open step, "
        f"{number(part.step_width)} x {number(part.step_height)} mm)",
        f"G0 {point(outside, low)} Z{number(CLEARANCE)}",
        f"G0 Z{number(-DEPTH)}",
        f"G1 {point(wall, low)} F{FEED}",
        f"G1 {point(wall, high)}",
        *leave,
        f"G0 Z{number(CLEARANCE)}",
    ]


def square_pocket(part: Part) -> list[str]:
    """Return the square pocket: down along a square, its floor, then its walls."""
    x, y = part.square_x, part.height / 2
    wall = part.square / 2 - RADIUS
    rough = wall - part.finish
    lines = [
        f"(square pocket: {number(part.square)} x {number(part.square)} mm, "
        f"finishing cut {number(part.finish)} mm)",
        f"G0 {point(x - rough, y - rough)}",
        f"G1 Z0 F{FEED}",
    ]
    corners = [(1, -1), (1, 1), (-1, 1), (-1, -1)]
    for i, (u, v) in enumerate(corners[: part.ramp_sides]):
        z = -DEPTH * (i + 1) / part.ramp_sides
        lines.append(f"G1 {point(x + u * rough, y + v * rough, z)}")
    # Once around at full depth, from where the ramp ends, and on to the first corner.
    rest = corners[part.ramp_sides :] + corners[: part.ramp_sides]
    back = corners[part.ramp_sides :] if part.finish > 0 else []
    lines += [f"G1 {point(x + u * rough, y + v * rough)}" for u, v in rest + back]
    if part.finish > 0:
        lines.append(f"G1 {point(x - wall, y - wall)}")
        lines += [f"G1 {point(x + u * wall, y + v * wall)}" for u, v in corners]
    lines.append(f"G0 Z{number(CLEARANCE)}")
    return lines


def circular_pocket(part: Part) -> list[str]:
    """Return the circular pocket: helix, floor, and out by half a turn if needed."""
    x, y = part.circle_x, part.height / 2
    inner, wall = part.helix / 2, part.circle / 2 - RADIUS
    lines = [
        f"(circular pocket: diameter {number(part.circle)} mm, entered by a helix of "
        f"{number(part.helix)} mm)",
        f"G0 {point(x + inner, y)}",
        f"G1 Z0 F{FEED}",
        f"G3 {point(x + inner, y, -DEPTH)} I{number(-inner)} J0",
        f"G3 {point(x + inner, y)} I{number(-inner)} J0",
    ]
    if wall > inner:
        lines += [
            f"G3 {point(x - wall, y)} R{number((inner + wall) / 2)}",
            f"G3 {point(x - wall, y)} I{number(wall)} J0",
        ]
    return [*lines, f"G0 Z{number(CLEARANCE)}"]


def program(part: Part) -> str:
    """Return the G-code of a part."""
    lines = [
        "%",
        f"({part.name}: block {number(part.width)} x {number(part.height)} mm, "
        "top at Z0, corner at X0 Y0)",
        f"(flat end mill of {number(2 * RADIUS)} mm, depth {number(DEPTH)} mm)",
        "G21 G17 G90 G94",
        f"T1 M6 S{SPEED} M3",
        *step(part, is_right=True),
        *square_pocket(part),
        *circular_pocket(part),
        *step(part, is_right=False),
        "M5",
        "M2",
        "%",
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Write both programs."""
    root = pathlib.Path(__file__).resolve().parents[2]
    folder = root / "src" / "diffmill" / "examples"
    if len(sys.argv) > 1:
        folder = pathlib.Path(sys.argv[1])
    for part in (PAPER, PAPER_SMALL):
        file = folder / f"{part.name}.ngc"
        file.write_text(program(part), encoding="utf-8", newline="\n")
        print(f"wrote {file.name} for a block {part.width:g} x {part.height:g} mm")


if __name__ == "__main__":
    main()
