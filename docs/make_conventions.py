"""Draw conventions.png: frames, immersion angle and the signs of the forces.

Run `uv run python docs/make_conventions.py` in the root of the repository.
"""

import math
import pathlib
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle, Rectangle

BLUE, RED, GREEN, GREY = "#1f4e9c", "#b3261e", "#2e7d32", "#5f6368"
STOCK = "#e3d9c6"


def arrow(
    axes: Axes,
    start: tuple[float, float],
    end: tuple[float, float],
    label: str,
    *,
    color: str = "black",
    shift: tuple[float, float] = (0.0, 0.0),
    **options: Any,
) -> None:
    """Draw an arrow with its label beyond the tip."""
    style = {"arrowstyle": "-|>", "color": color, "lw": 1.8, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", xy=end, xytext=start, arrowprops=style)
    axes.text(
        end[0] + shift[0], end[1] + shift[1], label, color=color, ha="center",
        va="center", **options,
    )  # fmt: skip


def draw_cut(axes: Axes) -> None:
    """Draw the cut seen from the shank, in tool axes."""
    axes.add_patch(Rectangle((0.0, -1.0), 2.0, 2.0, color=STOCK, zorder=0))
    axes.add_patch(Rectangle((-1.9, 1.0), 3.9, 0.55, color=STOCK, zorder=0))
    axes.add_patch(Rectangle((-1.9, -1.55), 3.9, 0.55, color=STOCK, zorder=0))
    axes.add_patch(Circle((0, 0), 1.0, fc="white", ec="black", lw=1.5, zorder=1))
    arrow(axes, (0, 0), (0, 1.32), "tool +y", shift=(0, 0.1), color=GREY)
    arrow(axes, (0, 0), (1.32, 0), "tool +x", shift=(0.3, 0), color=GREY)
    phi = math.radians(55)
    e = (math.sin(phi), math.cos(phi))
    t = (math.cos(phi), -math.sin(phi))
    axes.plot([0, e[0]], [0, e[1]], color="black", lw=1.2)
    axes.plot(*e, "o", color="black", ms=6)
    arrow(
        axes, e, (1.62 * e[0], 1.62 * e[1]), "e (outward)", color=BLUE, shift=(0, 0.12)
    )
    end = (e[0] + 0.62 * t[0], e[1] + 0.62 * t[1])
    arrow(axes, e, end, "t (way of the tooth)", color=BLUE, shift=(0.18, -0.22))
    back = (e[0] - 0.62 * t[0], e[1] - 0.62 * t[1])
    arrow(axes, e, back, r"$-F_t\,t$", color=RED, shift=(-0.05, 0.13))
    inward = (0.42 * e[0], 0.42 * e[1])
    arrow(axes, e, inward, r"$-F_r\,e$", color=RED, shift=(0.12, -0.16))
    arc = {"theta1": 35, "theta2": 90, "color": GREEN, "lw": 1.8}
    axes.add_patch(Arc((0, 0), 0.9, 0.9, **arc))
    axes.text(0.2, 0.56, r"$\varphi$", color=GREEN, fontsize=13)
    axes.add_patch(Arc((0, 0), 1.5, 1.5, theta1=195, theta2=255, color=GREY, lw=1.5))
    tip = (0.75 * math.cos(math.radians(195)), 0.75 * math.sin(math.radians(195)))
    arrow(
        axes, (tip[0] + 0.005, tip[1] - 0.02), (tip[0], tip[1] + 0.04), "", color=GREY
    )
    axes.text(-0.45, -0.33, "clockwise", color=GREY, ha="center", fontsize=8)
    arrow(axes, (-1.75, 0.0), (-1.2, 0.0), "feed", shift=(-0.3, 0.14))
    axes.text(0, -1.35, "stock", ha="center", color=GREY)
    axes.set_title("Seen from the shank, feed along tool +x")
    axes.set_xlim(-1.95, 2.05)
    axes.set_ylim(-1.6, 1.75)


def draw_side(axes: Axes) -> None:
    """Draw the tool, the stock and the frames from the side."""
    axes.add_patch(Rectangle((-1.9, -1.5), 3.9, 1.5, color=STOCK, zorder=0))
    axes.add_patch(Rectangle((-1.9, -0.35), 1.9, 0.35, color="white", zorder=0.5))
    mill = Rectangle((-0.45, -0.35), 0.9, 1.6, fc="#eceff1", ec="black", lw=1.3)
    axes.add_patch(mill)
    axes.text(0.52, 0.95, "shank", color=GREY)
    arrow(axes, (0, -0.35), (0, 0.75), "tool +z", shift=(0.02, 0.12), color=BLUE)
    axes.plot(0, -0.35, "o", color=BLUE, ms=6)
    axes.text(0.03, -0.55, "tip = origin of tool", color=BLUE, ha="center")
    arrow(axes, (0.3, -0.35), (0.3, 0.2), r"$+F_a z$", color=RED, shift=(0.5, 0))
    arrow(axes, (-1.7, -1.3), (-1.7, -0.7), "work z", color=GREEN, shift=(0.02, 0.12))
    arrow(axes, (-1.7, -1.3), (-1.0, -1.3), "work x", color=GREEN, shift=(0.3, 0))
    style = {
        "arrowstyle": "<|-|>",
        "color": "black",
        "lw": 1,
        "shrinkA": 0,
        "shrinkB": 0,
    }
    axes.annotate("", xy=(-1.2, 0), xytext=(-1.2, -0.35), arrowprops=style)
    axes.plot([-1.9, 0], [0, 0], ls=":", color=GREY, lw=1)
    axes.text(-1.12, -0.2, "axial depth", fontsize=8)
    axes.set_title("Seen from the side")
    axes.set_xlim(-1.95, 2.05)
    axes.set_ylim(-1.6, 1.75)


def main() -> None:
    """Write conventions.png beside this script."""
    matplotlib.use("Agg")
    figure = Figure(figsize=(10.5, 4.8), dpi=120, layout="constrained")
    left, right = figure.subplots(1, 2)
    for axes, draw in ((left, draw_cut), (right, draw_side)):
        draw(axes)
        axes.set_aspect("equal")
        axes.set_axis_off()
    figure.savefig(pathlib.Path(__file__).with_name("conventions.png"))


if __name__ == "__main__":
    main()
