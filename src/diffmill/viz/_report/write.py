"""All figures of a result as PNG files, with the captions that the report prints."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import equinox as eqx
import numpy as np

from ...robot import Robot
from ...sim import ToothChip
from ...workpiece import SurfaceError
from .._cases import (
    case_names,
    place_text,
    reference_case,
    shown_cases,
    values_of,
)
from .._figure.chip import plot_chip
from .._figure.dexels import CutDexels, plot_cut_dexels
from .._figure.forces import ForceTrace, plot_forces
from .._figure.history import plot_deviation
from .._figure.joints import plot_joints
from .._figure.paths import plan_magnification, plot_paths, worst_places
from .._figure.sensitivity import plot_sensitivity
from .._figure.surface import plot_surface_error
from .._style import GREY, case_style, save_figure

if TYPE_CHECKING:
    import matplotlib.figure
    import xarray


class FigureFile(eqx.Module):
    """One figure of a run: the file, or the reason why there is none.

    Attributes:
        title: Title in a few words.
        caption: Caption for the report.
        path: The PNG, or None when the figure was skipped.
        skipped: Reason why it was skipped; empty when it was written.
    """

    title: str = eqx.field(static=True)
    caption: str = eqx.field(static=True, default="")
    path: Path | None = eqx.field(static=True, default=None)
    skipped: str = eqx.field(static=True, default="")


class _Drawing(eqx.Module):
    """A figure before it is written; None with the reason in `text`."""

    title: str = eqx.field(static=True)
    text: str = eqx.field(static=True)
    figure: "matplotlib.figure.Figure | None" = eqx.field(static=True, default=None)


def write_figures(
    out_dir: str | os.PathLike,
    dataset: "xarray.Dataset",
    *,
    is_chosen: Callable[[str], bool] = lambda name: True,
    forces: ForceTrace | None = None,
    chip: ToothChip | None = None,
    chip_row: int | None = None,
    dexels: CutDexels | None = None,
    surfaces: dict[str, SurfaceError] | None = None,
    robot: Robot | None = None,
) -> dict[str, FigureFile]:
    """Write the figures of a result; those whose inputs are absent are skipped.

    Args:
        out_dir: Existing folder for the PNG files.
        dataset: A result of `simulate` or `correct`.
        is_chosen: Whether the figure of a name is written; all by default.
        forces: Force within the tooth periods; without it the figure shows the
            mean over each tooth period from `dataset`.
        chip: Chip chart of one tooth.
        chip_row: Step of the reference case at which its revolution ends, if known.
        dexels: Ends of the cut rays, of the reference case.
        surfaces: Error of the machined surface, by case.
        robot: The robot of the job, for the limits of its joints.

    Returns:
        By name, in the report's order: paths, deviation, forces, chip, surface,
        dexels, joints where a robot moves, and sensitivity where the result has it. A
        skipped figure has `path` None and the reason in `skipped`.
    """
    folder = Path(out_dir)
    left_out = dataset.attrs.get("surface_left_out")
    drawings = {
        "paths": lambda: _draw_paths(dataset),
        "deviation": lambda: _draw_deviation(dataset),
        "forces": lambda: _of_reference(_draw_forces(dataset, forces), dataset),
        "chip": lambda: _of_reference(_draw_chip(chip, chip_row, dataset), dataset),
        "surface": lambda: _draw_surface(surfaces, left_out),
        "dexels": lambda: _of_reference(_draw_dexels(dexels), dataset),
    }
    if robot is not None and "motor_positions" in dataset:
        drawings["joints"] = lambda: _draw_joints(dataset, robot)
    if "sensitivity_contour_vector" in dataset:
        drawings["sensitivity"] = lambda: _draw_sensitivity(dataset)
    files = {}
    for name, draw in drawings.items():
        if not is_chosen(name):
            continue
        drawing = draw()
        if drawing.figure is None:
            files[name] = FigureFile(drawing.title, skipped=drawing.text)
            continue
        path = save_figure(drawing.figure, folder / f"{name}.png")
        files[name] = FigureFile(drawing.title, drawing.text, path)
    return files


def _of_reference(drawing: _Drawing, dataset: "xarray.Dataset") -> _Drawing:
    """Drawing with the name of its case, if there are several."""
    if drawing.figure is None or len(case_names(dataset)) < 2:
        return drawing
    label = case_style(reference_case(dataset)).label
    # Below on the left, where no legend and no axis stands.
    drawing.figure.text(0.005, 0.004, label, fontsize=9, color=GREY)
    text = f"Of the {label} path. {drawing.text}"
    return _Drawing(drawing.title, text, drawing.figure)


def _missing(dataset: "xarray.Dataset", *names: str) -> str:
    """Sentence on the variables that the dataset lacks; or nothing."""
    absent = [name for name in names if name not in dataset]
    if absent:
        return f"the result has no {', '.join(absent)}"
    return "" if dataset.sizes.get("step", 0) > 2 else "the result has under 3 steps"


def _draw_paths(dataset: "xarray.Dataset") -> _Drawing:
    title = "Desired and actual path"
    reason = _missing(dataset, "time", "desired", "deviation")
    if reason:
        return _Drawing(title, reason)
    factor = plan_magnification(dataset)
    magnified = f"magnified {factor:g} times" if factor != 1 else "drawn true to scale"
    first, second = (case_style(p.case).label for p in worst_places(dataset))
    places = (
        f"A and B are the two places where the {first} path is farthest from the "
        f"desired line in this view"
        if first == second
        else f"A is the place where the {first} path is farthest from the desired line "
        f"in this view, B that of the {second} path"
    )
    caption = (
        f"Plan view: the distance of each path from the desired one (dashed; grey: "
        f"moves in the air) is {magnified}, only where the tool cuts, as its walls "
        f"show it. {places}; both are drawn to their own scale, nothing "
        f"magnified, with one dot per tooth. The side view shows the height of the "
        f"tool tip above the desired path, over the length of the path."
    )
    if len(case_names(dataset)) > 1:
        caption += " A path that follows the dashed line is what a correction is for."
    caption += _undrawn_note(dataset)
    return _Drawing(title, caption, plot_paths(dataset))


def _undrawn_note(dataset: "xarray.Dataset") -> str:
    """Return a sentence about cases that would hide all others on a linear scale."""
    shown = shown_cases(dataset)
    names = [case_style(n).label for n in case_names(dataset) if n not in shown]
    if not names:
        return ""
    reference = case_style(reference_case(dataset)).label
    return (
        f" Not drawn to this scale, because more than twice as far off as "
        f"{reference}: {', '.join(names)}."
    )


def _draw_deviation(dataset: "xarray.Dataset") -> _Drawing:
    title = "Deviation over time"
    reason = _missing(dataset, "time", "desired", "deviation")
    if reason:
        return _Drawing(title, reason)
    caption = (
        "Actual minus desired tip position at the same instant, in x, y and z. "
        "Shaded: the tool does not cut, and curves may leave the panel, whose scale is "
        "that of the cut."
    )
    if "contour_error" in dataset:
        caption += (
            " The contour error is the distance to the desired line whatever the "
            "time, which is what stays on the part; the lowest panel repeats its size "
            "on a logarithmic scale, so that small errors show beside large ones."
        )
    caption += _undrawn_note(dataset)
    return _Drawing(title, caption, plot_deviation(dataset))


def _draw_forces(dataset: "xarray.Dataset", forces: ForceTrace | None) -> _Drawing:
    title = "Cutting force"
    reason = "" if forces is not None else _missing(dataset, "time", "force")
    if reason:
        return _Drawing(title, reason)
    record = forces
    if record is None:
        case = reference_case(dataset)
        time = values_of(dataset, "time", case)
        means = np.nan_to_num(values_of(dataset, "force", case))
        record = ForceTrace(time, means, float(time[1] - time[0]), True)
    caption = "Force of the workpiece on the tool in workpiece axes"
    if record.force_range is not None:
        caption += (
            ". Grey: from the least to the largest force at any angle in each tooth "
            "period; on the right every computed sample of some periods, where the "
            "tool went along a smooth curve through its tooth instants. Black: the "
            "mean over each tooth period, of which a low-pass (Butterworth of order 4, "
            "forward and backward) leaves what is below 100 Hz, to which a robot's "
            "arm can answer."
        )
    elif record.is_tooth_mean:
        caption += ", as its mean over each tooth period."
    else:
        caption += (
            ". Grey: every computed sample, teeth going in and out. Black: what is "
            "left below 100 Hz, to which a robot's arm can answer; the filter is a "
            "Butterworth of order 4 run forward and backward, so it delays nothing."
        )
    return _Drawing(title, caption, plot_forces(record))


def _draw_chip(
    chip: ToothChip | None, row: int | None, dataset: "xarray.Dataset"
) -> _Drawing:
    title = "Chip thickness of one tooth"
    if chip is None:
        return _Drawing(title, "no chip chart was computed")
    caption = (
        "What one tooth cuts on its way through the material: angle from the left of "
        "the feed, clockwise; height along the tool from its tip. White: no chip, or "
        "less than a hundredth of the thickest. Each curve below is one disc of the "
        "cutter. Where the tool goes straight, discs of one radius that lie wholly "
        "in the material coincide; a disc that is partly in it, mostly the "
        "uppermost, counts with that part, and its curve is lower."
    )
    if row is not None and "desired" in dataset:
        place = place_text(dataset, reference_case(dataset), row)
        caption += f" The revolution ends {place}."
    return _Drawing(title, caption, plot_chip(chip))


def _draw_surface(
    surfaces: dict[str, SurfaceError] | None, left_out: str | None
) -> _Drawing:
    title = "Error of the machined surface"
    if left_out:
        return _Drawing(title, left_out)
    if surfaces is None:
        return _Drawing(title, "no surface error was computed")
    if not any(item.is_across.any() for item in surfaces.values()):
        return _Drawing(title, "nothing was cut, or nothing is left")
    caption = (
        "Distance of the machined surface from the ideal one, seen from above: floors, "
        "and walls as lines with the largest error over their height. Blue: cut too "
        "deep; red: material left; grey: not cut. All maps share one scale, each "
        "histogram has its own; above it rms and mean of what the tool cut."
    )
    return _Drawing(title, caption, plot_surface_error(surfaces))


def _draw_dexels(dexels: CutDexels | None) -> _Drawing:
    title = "Cut ray ends of the workpiece"
    if dexels is None:
        return _Drawing(title, "no ray ends were handed over")
    if not dexels.floor.shape[0] and not dexels.wall.shape[0]:
        return _Drawing(title, "no ray was cut")
    caption = (
        "Where the rays that model the workpiece end after the cut, moved away from "
        "their ideal ends, magnified as the titles say: the waves of the floor, and "
        "below the profile of the wall that most x rays end on. Ends on a surface that "
        "the ideal part does not have are left out."
    )
    return _Drawing(title, caption, plot_cut_dexels(dexels))


def _draw_joints(dataset: "xarray.Dataset", robot: Robot) -> _Drawing:
    title = "Joint positions"
    reason = _missing(dataset, "time")
    if reason:
        return _Drawing(title, reason)
    caption = (
        "Motion of each joint, on the left with the limits of the joint; a limit that "
        "is near is a red line on the right."
    )
    return _Drawing(title, caption, plot_joints(dataset, robot))


def _draw_sensitivity(dataset: "xarray.Dataset") -> _Drawing:
    caption = (
        "How far 10 % more of each parameter would move the tool across the desired "
        "path, to whichever side and to first order: stiffness K and damping D of the "
        "joints, the coefficients of the force law, and the speed of spindle and feed "
        "together. Where a correction leaves hardly any error, so much new error would "
        "come; elsewhere it may add to the error or take from it. Each stiffness has "
        "its own sag lifted, as touching off does. Grey: no cut."
    )
    return _Drawing("Sensitivity to the model", caption, plot_sensitivity(dataset))
