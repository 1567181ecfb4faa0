"""Figures of what measured parts have shown of a machine."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .._report.write import FigureFile
from .._style import GREY, INK, legend_above, new_figure, quiet_axes, save_figure
from .identified import FITTED, MISFIT

if TYPE_CHECKING:
    import matplotlib.figure

    from ...learning import LearnedMachine

# Causes of an error by their groups of parameters, in words.
CAUSES = {
    "stiffness": "stiffness",
    "damping": "damping",
    "force": "forces",
    "friction": "friction",
    "backlash": "backlash",
    "servo": "servos",
    "radius": "radius of the cutter",
    "field": "links, place of the work",
    "process": "none of these",
}


def plot_learnt(found: "LearnedMachine") -> "matplotlib.figure.Figure":
    """Draw the parameters that were learnt, in units of their priors.

    Args:
        found: What was learnt.

    Returns:
        The figure.
    """
    values = found.values()
    figure = new_figure(max(2.4, 0.19 * len(values) + 0.8))
    axes = figure.subplots()
    place = np.arange(len(values))[::-1]
    mean = np.array([one.value / one.size for one in values])
    error = np.array([one.error / one.size for one in values])
    axes.axvspan(-1, 1, color="#eef1f4", lw=0, label="before, 1 standard deviation")
    axes.axvline(0, color=GREY, lw=0.6)
    axes.errorbar(
        mean,
        place,
        xerr=1.96 * error,
        fmt="o",
        ms=3.5,
        lw=1.0,
        capsize=2,
        color=FITTED,
        label="learnt, 95 % interval",
    )
    axes.set_yticks(place, [one.name for one in values])
    axes.set_ylim(-0.7, len(values) - 0.3)
    quiet_axes(axes, x="value over its standard deviation beforehand")
    legend_above(figure, axes)
    return figure


def plot_causes(found: "LearnedMachine") -> "matplotlib.figure.Figure":
    """Draw the error across the path by cause, where the tool cuts.

    Args:
        found: What was learnt.

    Returns:
        The figure.
    """
    causes = found.causes()
    names = sorted(causes, key=lambda name: causes[name])
    figure = new_figure(0.28 * len(names) + 1.0)
    axes = figure.subplots()
    sizes = 1e6 * np.array([causes[name] for name in names])
    colours = [MISFIT if name == "process" else FITTED for name in names]
    axes.barh([CAUSES[name] for name in names], sizes, color=colours, height=0.6)
    for k, size in enumerate(sizes):
        axes.text(size, k, f" {size:.3g}", va="center", fontsize=8, color=INK)
    axes.margins(x=0.12)
    quiet_axes(axes, x="error across the path [\u00b5m rms]")
    return figure


def write_learning_figures(
    out_dir: str | os.PathLike[str], found: "LearnedMachine"
) -> dict[str, FigureFile]:
    """Write the figures of what was learnt.

    Args:
        out_dir: Existing folder for the PNG files.
        found: What was learnt.

    Returns:
        By name: causes, learnt.
    """
    folder = Path(out_dir)
    causes = (
        "Error of the last command by cause, where the tool cuts, each alone; some "
        "cancel. What no parameter explains is the process."
    )
    learnt = (
        "Parameters as the parts show them. One whose interval is as wide as before "
        "is not told by them."
    )
    return {
        name: FigureFile(title, text, save_figure(figure, folder / f"{name}.png"))
        for name, title, text, figure in (
            ("causes", "Causes", causes, plot_causes(found)),
            ("learnt", "What was learnt", learnt, plot_learnt(found)),
        )
    }
