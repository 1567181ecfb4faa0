"""Style of all figures: sizes, colours, quiet axes, and saving.

Colours are those of Okabe and Ito, which readers with any colour vision can tell
apart; a case has the same colour and line in every figure.
"""

from pathlib import Path
from typing import TYPE_CHECKING

import equinox as eqx
import numpy as np
from jaxtyping import Float

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.colorbar
    import matplotlib.figure

WIDTH_IN = 7.2
DPI = 160
GREY = "#9a9a9a"
LIGHT_GREY = "#d9d9d9"
INK = "#222222"
MICROMETRE = "\u00b5m"  # the micro sign, for text outside matplotlib


class CaseStyle(eqx.Module):
    """Look of one case in every figure.

    Attributes:
        label: Name for legends and tables.
        colour: Line colour, as hexadecimal RGB.
        line: Dash pattern in matplotlib's notation.
        width: Line width [pt].
    """

    label: str = eqx.field(static=True)
    colour: str = eqx.field(static=True)
    line: str = eqx.field(static=True, default="-")
    width: float = eqx.field(static=True, default=1.1)


CASE_STYLES = {
    "predicted": CaseStyle("predicted", "#D55E00"),
    "uncorrected": CaseStyle("uncorrected", "#D55E00"),
    "mirror": CaseStyle("mirror, one shot", "#E69F00", width=0.9),
    "mirror_iterated": CaseStyle("mirror, iterated", "#CC79A7", width=0.9),
    "input_shaper": CaseStyle("input shaper", "#56B4E9", width=0.9),
    "inverse_drive": CaseStyle("inverse drive", "#0072B2", width=1.0),
    "corrected": CaseStyle("corrected", "#009E73", width=1.3),
}
_SPARE_COLOURS = ("#882255", "#117733", "#999933", "#332288")


def case_style(name: str) -> CaseStyle:
    """Return the style of the case `name`; an unknown name gets a spare colour."""
    if name in CASE_STYLES:
        return CASE_STYLES[name]
    colour = _SPARE_COLOURS[sum(name.encode()) % len(_SPARE_COLOURS)]
    return CaseStyle(name.replace("_", " "), colour)


def new_figure(
    height_in: float, *, width_in: float = WIDTH_IN
) -> "matplotlib.figure.Figure":
    """Return an empty figure for a report page, without touching pyplot.

    Args:
        height_in: Height [inch].
        width_in: Width [inch].
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    size = width_in, height_in
    figure = Figure(figsize=size, dpi=DPI, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def quiet_axes(
    axes: "matplotlib.axes.Axes",
    *,
    x: str = "",
    y: str = "",
    title: str = "",
    has_grid: bool = True,
) -> None:
    """Label `axes` and take out the ink that carries no data."""
    axes.set_xlabel(x, fontsize=8.5, color=INK)
    axes.set_ylabel(y, fontsize=8.5, color=INK)
    if title:
        axes.set_title(title, fontsize=9, loc="left", color=INK)
    axes.tick_params(labelsize=8, color=GREY, labelcolor=INK, length=3, width=0.6)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(GREY)
        axes.spines[side].set_linewidth(0.6)
    if has_grid:
        axes.grid(True, color="#ececec", linewidth=0.6)
        axes.set_axisbelow(True)


def label_colourbar(bar: "matplotlib.colorbar.Colorbar", text: str) -> None:
    """Write the quantity of a colour bar in the figures' type size."""
    bar.set_label(text, fontsize=8.5, color=INK)
    bar.ax.tick_params(labelsize=8, color=GREY, labelcolor=INK, length=3, width=0.6)
    bar.outline.set_visible(False)


def legend_above(
    figure: "matplotlib.figure.Figure",
    axes: "matplotlib.axes.Axes",
    *,
    columns: int = 6,
) -> None:
    """Put one legend for the whole figure above it, where it covers no data."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(
        handles,
        labels,
        loc="outside upper left",
        ncols=min(columns, max(len(labels), 1)),
        fontsize=8,
        frameon=False,
        handlelength=1.8,
        columnspacing=1.4,
    )


def save_figure(figure: "matplotlib.figure.Figure", path: Path) -> Path:
    """Write `figure` as PNG and return the path; its layout is then fixed."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    _fix_layout(figure)
    canvas = figure.canvas
    if isinstance(canvas, FigureCanvasAgg) and figure.get_dpi() == DPI:
        # `Figure.savefig` draws twice: once to lay out what is laid out already.
        canvas.print_png(path)
    else:
        figure.savefig(path, dpi=DPI, facecolor="white")
    return path


def _fix_layout(figure: "matplotlib.figure.Figure") -> None:
    """Lay a finished figure out, once: matplotlib does so twice for a file."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine("none")


def scale_ratio(axes: "matplotlib.axes.Axes", x_unit: float, y_unit: float) -> str:
    """Ratio of the drawn scales of y and x, with two digits.

    Args:
        axes: Finished axes of a finished figure; its layout is then fixed, so that
            titles keep their height from here on.
        x_unit: Length that 1 on the x axis stands for [m].
        y_unit: Length that 1 on the y axis stands for [m].
    """
    figure = axes.get_figure(root=True)
    if figure is None:
        raise ValueError("Argument `axes` must belong to a figure, but has none.")
    _fix_layout(figure)
    box = axes.get_window_extent()
    (x_low, x_high), (y_low, y_high) = axes.get_xlim(), axes.get_ylim()
    y_scale = box.height / max((y_high - y_low) * y_unit, 1e-15)
    ratio = y_scale * (x_high - x_low) * x_unit / max(box.width, 1.0)
    return f"{float(f'{ratio:.2g}'):g}"


def round_factor(value: float) -> float:
    """Return the largest of 1, 2, 5, 10, 20, ... that is not above `value`."""
    if not np.isfinite(value) or value <= 1.0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    steps = np.array([1.0, 2.0, 5.0])
    return float(steps[steps <= value / power * (1 + 1e-9)][-1] * power)


def spread(values: Float[np.ndarray, "..."], percent: float = 95.0) -> float:
    """Return the percentile of the finite absolute values, 0 when there are none."""
    finite = np.abs(values[np.isfinite(values)])
    return float(np.percentile(finite, percent)) if finite.size else 0.0


def number_text(value: float) -> str:
    """Return three digits, without an exponent where that is readable; "-" for NaN."""
    if not np.isfinite(value):
        return "-"
    value = float(f"{value:.3g}")
    if value == 0 or 1e-3 <= abs(value) < 1e6:
        digits = 0 if value == 0 else max(0, 2 - int(np.floor(np.log10(abs(value)))))
        return f"{value:.{digits}f}"
    return f"{value:.3g}"


def length_text(length: float) -> str:
    """Return a length [m] with three digits at most, in micrometres or millimetres."""
    if not abs(length) >= 0.9995e-3:
        return f"{1e6 * length:.3g} {MICROMETRE}"
    return f"{1e3 * length:.3g} mm"
