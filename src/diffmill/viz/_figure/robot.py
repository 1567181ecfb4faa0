"""The robot: its line figure in three views, and how stiff it is over its workspace."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ...robot import Robot, Skeleton, StiffnessMap
from .._style import GREY, INK, label_colourbar, new_figure, quiet_axes

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.collections
    import matplotlib.figure

_LINK = "#56B4E9"
_JOINT = "#0072B2"
_FRAME = ("#D55E00", "#009E73", "#0072B2")  # x, y, z of the tool
_UNREACHED = "#dcdcdc"
_MARKS = {"revolute": "o", "prismatic": "s"}


def plot_robot(
    robot: Robot, bones: Skeleton, *, title: str = ""
) -> "matplotlib.figure.Figure":
    """Draw the arm as lines in three views, with its joints and the tool's frame.

    Args:
        robot: The robot.
        bones: Its joints at a pose.
        title: Above the figure.

    Returns:
        The figure.
    """
    lines = arm_lines(robot, bones)
    points = np.concatenate([np.zeros((1, 3)), *lines])
    span = float(np.max(np.ptp(points, axis=0))) or 1.0
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    figure = new_figure(3.2)
    panels = figure.subplots(1, 3)
    views = {"from the side": "xz", "from the front": "yz", "from above": "xy"}
    for panel, (name, plane) in zip(panels, views.items(), strict=True):
        i, j = StiffnessMap.axes_of(plane)
        draw_arm(panel, robot, bones, plane, arrow=0.14 * span)
        panel.set_xlim(middle[i] - 0.62 * span, middle[i] + 0.62 * span)
        panel.set_ylim(middle[j] - 0.62 * span, middle[j] + 0.62 * span)
        panel.set_aspect("equal")
        quiet_axes(panel, x=f"{plane[0]} [m]", y=f"{plane[1]} [m]", title=name)
    _label_joints(panels[0], robot, bones, "xz", span)
    _explain(figure, robot, panels[0])
    if title:
        figure.suptitle(title, fontsize=9.5, color=INK, x=0.01, ha="left")
    return figure


def plot_stiffness(
    robot: Robot,
    bones: Skeleton,
    maps: Sequence[StiffnessMap],
    *,
    title: str = "",
) -> "matplotlib.figure.Figure":
    """Draw the least stiffness of the tip on planes, and the arm in front of it.

    Args:
        robot: The robot.
        bones: Its joints at the pose that the planes go through.
        maps: One or more planes; they share one colour scale.
        title: Above the figure.

    Returns:
        The figure.
    """
    finite = np.concatenate([m.stiffness[np.isfinite(m.stiffness)] for m in maps])
    if not finite.size:
        raise ValueError(
            "Argument `maps` must hold a finite stiffness, but the arm is rigid or "
            "reaches nothing."
        )
    low, high = 1e-6 * float(finite.min()), 1e-6 * float(finite.max())
    windows = [_window(item, bones, item.plane) for item in maps]
    aspect = max(np.ptp(up) / np.ptp(across) for across, up in windows)
    figure = new_figure(float(np.clip(0.9 + 3.0 * aspect, 2.2, 4.4)))
    panels = np.atleast_1d(figure.subplots(1, len(maps)))
    images = [
        _draw_map(panel, item, low, high)
        for panel, item in zip(panels, maps, strict=True)
    ]
    for panel, item, window in zip(panels, maps, windows, strict=True):
        draw_arm(panel, robot, bones, item.plane, arrow=0.0, is_faint=True)
        panel.set_xlim(*window[0])
        panel.set_ylim(*window[1])
        panel.set_aspect("equal")
        _name_plane(panel, item.plane, np.asarray(bones.tool))
    bar = figure.colorbar(images[0], ax=list(panels), pad=0.02, aspect=25, shrink=0.9)
    label_colourbar(bar, r"least stiffness of the tip [N/$\mathrm{\mu m}$]")
    if title:
        figure.suptitle(title, fontsize=9.5, color=INK, x=0.01, ha="left")
    return figure


def _draw_map(
    axes: "matplotlib.axes.Axes", item: StiffnessMap, low: float, high: float
) -> "matplotlib.collections.QuadMesh":
    """Draw one plane in N/um; what is not reached is left grey."""
    axes.set_facecolor(_UNREACHED)
    return axes.pcolormesh(
        item.across,
        item.up,
        1e-6 * np.where(np.isfinite(item.stiffness), item.stiffness, np.nan),
        cmap="viridis",
        vmin=low,
        vmax=max(high, 1.01 * low),
        rasterized=True,
    )


def _name_plane(
    axes: "matplotlib.axes.Axes",
    plane: str,
    tool: Float[np.ndarray, " 3"],
) -> None:
    """Label the axes of a plane and say where it lies."""
    (across,) = set("xyz") - set(plane)
    place = round(float(tool["xyz".index(across)]), 2)
    quiet_axes(
        axes,
        x=f"{plane[0]} [m]",
        y=f"{plane[1]} [m]",
        # Adding 0 after rounding takes the sign off a zero.
        title=f"plane {across} = {place + 0.0:.2f} m",
        has_grid=False,
    )


def draw_arm(
    axes: "matplotlib.axes.Axes",
    robot: Robot,
    bones: Skeleton,
    plane: str,
    *,
    arrow: float,
    is_faint: bool = False,
) -> None:
    """Draw links, joints and the tool's frame, seen along one base axis.

    Args:
        axes: Axes of the drawing.
        robot: The robot.
        bones: Its joints at a pose.
        plane: The two base axes that are seen, across and up, such as "xz".
        arrow: Length of the tool's axes [m]; 0 draws a cross at the tip instead.
        is_faint: True if the arm only stands in front of something else.
    """
    i, j = StiffnessMap.axes_of(plane)
    colour = "white" if is_faint else _LINK
    width = 1.4 if is_faint else 4.0
    for line in arm_lines(robot, bones):
        if is_faint:
            axes.plot(line[:, i], line[:, j], color=INK, linewidth=2.4, zorder=3)
        axes.plot(
            line[:, i],
            line[:, j],
            color=colour,
            linewidth=width,
            solid_capstyle="round",
            zorder=4,
        )
    origins = np.asarray(bones.origins)
    for k, kind in enumerate(robot.body_kinds):
        mark = "D" if _is_virtual(robot)[k] else _MARKS[kind]
        axes.plot(
            origins[k, i],
            origins[k, j],
            mark,
            color="white",
            markeredgecolor=INK if is_faint else _JOINT,
            markersize=3.0 if is_faint else 5.0,
            zorder=5,
        )
    _draw_tool(axes, bones, plane, arrow)


def _draw_tool(
    axes: "matplotlib.axes.Axes", bones: Skeleton, plane: str, arrow: float
) -> None:
    """Draw the tool's axes as arrows, or a cross if `arrow` is 0."""
    i, j = StiffnessMap.axes_of(plane)
    tool, R = np.asarray(bones.tool), np.asarray(bones.tool_rotation)
    if not arrow:
        axes.plot(tool[i], tool[j], "x", color=_FRAME[0], markersize=7, zorder=6)
        return
    for axis, shade in enumerate(_FRAME):
        end = tool + arrow * R[:, axis]
        axes.annotate(
            "",
            xy=(end[i], end[j]),
            xytext=(tool[i], tool[j]),
            arrowprops={
                "arrowstyle": "-|>", "color": shade, "lw": 1.2, "shrinkA": 0,
                "shrinkB": 0,
            },
            zorder=6,
        )  # fmt: skip


def _is_virtual(robot: Robot) -> list[bool]:
    """Return per body whether its joint is virtual; a follower is what it follows."""
    own = iter(robot.is_virtual)
    return [next(own) if m is None else robot.is_virtual[m[0]] for m in robot.mimics]


def arm_lines(robot: Robot, bones: Skeleton) -> list[Float[np.ndarray, "point 3"]]:
    """Return a line per body from its parent's joint to its own, and the tool's."""
    origins, mounts = np.asarray(bones.origins), np.asarray(bones.mounts)
    start = lambda body: origins[body] if body >= 0 else np.zeros(3)
    lines = [
        np.stack([start(parent), mounts[k], origins[k]])
        for k, parent in enumerate(robot.parents)
    ]
    end = [start(robot.flange_joint), np.asarray(bones.flange), np.asarray(bones.tool)]
    return [*lines, np.stack(end)]


def _label_joints(
    axes: "matplotlib.axes.Axes",
    robot: Robot,
    bones: Skeleton,
    plane: str,
    span: float,
) -> None:
    """Write the joints' names beside them, those at one place on one label."""
    from matplotlib.patheffects import withStroke

    own = [k for k, mimic in enumerate(robot.mimics) if mimic is None]
    places: list[tuple[np.ndarray, list[str]]] = []
    for name, k in zip(robot.joint_names, own, strict=True):
        at = np.asarray(bones.origins)[k][StiffnessMap.axes_of(plane)]
        near = [names for p, names in places if np.linalg.norm(p - at) < 0.09 * span]
        if near:
            near[0].append(name)
        else:
            places.append((at, [name]))
    for at, names in places:
        axes.annotate(
            "\n".join(names),
            (float(at[0]), float(at[1])),
            xytext=(6, 4),
            textcoords="offset points",
            fontsize=6.5,
            color=INK,
            path_effects=[withStroke(linewidth=2, foreground="white")],
            zorder=7,
        )


def _explain(
    figure: "matplotlib.figure.Figure", robot: Robot, axes: "matplotlib.axes.Axes"
) -> None:
    """Put a legend of the marks and of the tool's axes below the views."""
    from matplotlib.lines import Line2D

    marks = {
        "o": "turns",
        "s": "slides",
        "D": "virtual joint (spring, no motor)",
    }
    kinds = zip(robot.body_kinds, _is_virtual(robot), strict=True)
    used = {"D" if virtual else _MARKS[kind] for kind, virtual in kinds}
    handles = [
        Line2D([], [], marker=mark, linestyle="", color="white", markersize=5,
               markeredgecolor=_JOINT, label=text)
        for mark, text in marks.items()
        if mark in used
    ]  # fmt: skip
    handles += [
        Line2D([], [], color=shade, linewidth=1.4, label=f"tool {name}")
        for name, shade in zip("xyz", _FRAME, strict=True)
    ]
    figure.legend(
        handles=handles,
        loc="outside lower left",
        ncols=len(handles),
        fontsize=8,
        frameon=False,
        handlelength=1.4,
        columnspacing=1.4,
    )
    axes.axhline(0.0, color=GREY, linewidth=0.6, zorder=1)


def _window(
    item: StiffnessMap, bones: Skeleton, plane: str
) -> list[tuple[float, float]]:
    """Return limits of the axes: what is mapped, and the arm."""
    limits = []
    for axis, values in zip(
        StiffnessMap.axes_of(plane), (item.across, item.up), strict=True
    ):
        points = np.asarray(bones.origins)[:, axis]
        low = min(values.min(), points.min(), 0.0)
        high = max(values.max(), points.max(), 0.0)
        margin = 0.03 * (high - low)
        limits.append((float(low - margin), float(high + margin)))
    return limits
