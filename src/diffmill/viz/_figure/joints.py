"""Joint positions of a run within their limits."""

from typing import TYPE_CHECKING

import numpy as np

from ...robot import Robot
from .._cases import (
    ABSCISSA_LABELS,
    Abscissa,
    abscissa,
    chosen_case,
    reference_case,
    values_of,
)
from .._style import GREY, INK, case_style, legend_above, new_figure, quiet_axes

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure
    import xarray

_LIMIT = "#b3261e"
_LEAST_SPAN = 0.01  # of a vertical axis [deg or mm]


def plot_joints(
    dataset: "xarray.Dataset", robot: Robot, *, over: Abscissa = "time"
) -> "matplotlib.figure.Figure":
    """Draw the positions of the motors, of the program and of its correction.

    Args:
        dataset: A result of `simulate` or `correct`.
        robot: The robot of its job.
        over: Quantity of the horizontal axis.

    Returns:
        The figure, a row for each joint with a motor: on the left the range of its
        motion between its limits, on the right its motion.
    """
    motors = robot.motor_joints
    figure = new_figure(0.7 + 1.1 * len(motors))
    rows = figure.subplots(
        len(motors), 2, sharex="col", squeeze=False, width_ratios=[1, 14]
    )
    cases = dict.fromkeys([reference_case(dataset), chosen_case(dataset)])
    scales, units = shown_units(robot)
    for (left, right), joint in zip(rows, motors, strict=True):
        limits = [
            scales[joint] * float(side[joint])
            for side in (robot.joint_lower, robot.joint_upper)
        ]
        for case, dashes in zip(cases, ("-", (0, (3, 2))), strict=False):
            right.plot(
                abscissa(dataset, case, over),
                scales[joint] * values_of(dataset, "motor_positions", case)[:, joint],
                color=case_style(case).colour,
                linewidth=case_style(case).width,
                linestyle=dashes,
                label=case_style(case).label,
            )
        quiet_axes(right, title=f"{robot.joint_names[joint]} [{units[joint]}]")
        right.ticklabel_format(useOffset=False, style="plain")
        # Rounding of a joint that rests is no motion.
        low, high = right.get_ylim()
        rest = max(0.5 * (_LEAST_SPAN - (high - low)), 0.0)
        right.set_ylim(low - rest, high + rest)
        _draw_range(left, right, limits)
    rows[-1, 1].set_xlabel(ABSCISSA_LABELS[over], fontsize=8.5, color=INK)
    legend_above(figure, rows[0, 1])
    return figure


def shown_units(robot: Robot) -> tuple[np.ndarray, list[str]]:
    """Factors from the units of the joints to those that are shown, and these."""
    shown = {"rad": (np.degrees(1.0), "deg"), "m": (1e3, "mm")}
    pairs = [shown[unit] for unit in robot.joint_units]
    return np.array([scale for scale, _ in pairs]), [unit for _, unit in pairs]


def _draw_range(
    left: "matplotlib.axes.Axes", right: "matplotlib.axes.Axes", limits: list[float]
) -> None:
    """Draw the range of a motion between the joint's limits, and those in its sight."""
    left.set_xticks([])
    if not np.isfinite(limits).all():
        left.set_axis_off()
        left.text(0.5, 0.5, "no limits", ha="center", va="center", fontsize=7)
        return
    moved = np.concatenate([np.asarray(line.get_ydata()) for line in right.lines])
    left.axhspan(np.nanmin(moved), np.nanmax(moved), color=INK)
    # A joint that hardly moves would leave no mark.
    left.axhline(float(np.nanmean(moved)), color=INK, linewidth=1.5)
    left.set_ylim(*limits)
    left.set_yticks(limits, [f"{limit:.3g}" for limit in limits])
    left.tick_params(labelsize=7, color=GREY, labelcolor=INK, length=2)
    for side in left.spines.values():
        side.set_color(GREY)
    seen = right.get_ylim()
    for limit in limits:
        right.axhline(limit, color=_LIMIT, linewidth=0.9)
    right.set_ylim(seen)
