"""The same cut in any direction of space: stock, path and axis turned together."""

import numpy as np
from scipy.spatial.transform import Rotation

import diffmill as dm
from cuts import (
    ALONG,
    FEED,
    RADIUS,
    SLOTS,
    SPACING,
    UP,
    box_corners,
    cut,
    hexahedron,
    mean_force,
    mill,
    reference_force,
    shoulder,
    straight,
)
from reporting import Report, relative

COUNT = 6
DEPTH = 1e-3


def measure(report: Report) -> None:
    """Measure a half immersion of a flat cutter and a slot of a ball."""
    for kind, radial_depth in (("flat", RADIUS), ("ball", 2 * RADIUS)):
        wanted = reference_force(
            kind, shoulder(DEPTH, radial_depth, is_up=True), FEED * ALONG
        ).mean(axis=0)
        upright = _turned(kind, radial_depth, Rotation.identity())
        size = np.linalg.norm(upright)
        name = f"{kind}, radial depth {1e3 * radial_depth:g} mm"
        report.say()
        report.say(f"{name}: upright {size:.2f} N, {_percent(upright, wanted)} % off")
        report.say("the reference; turned: change of the size, and of the vector [%]")
        changes = []
        for turn in Rotation.random(COUNT, rng=np.random.default_rng(17)):
            force = turn.inv().apply(_turned(kind, radial_depth, turn))
            changes.append(100 * abs(np.linalg.norm(force) / size - 1))
            report.say(
                f"  axis {np.round(turn.apply(UP), 2)!s:22} {changes[-1]:8.2f}"
                f"{_percent(force, upright):>8}, against the reference "
                f"{_percent(force, wanted)}"
            )
        # Not a number must not pass.
        worst = float(np.max(changes))
        report.figure(f"{name}: largest change of the size", worst, 2.0)


def _percent(found: np.ndarray, wanted: np.ndarray) -> str:
    return f"{100 * relative(found, wanted):.2f}"


def _turned(kind: str, radial_depth: float, turn: Rotation) -> np.ndarray:
    """Return the mean force in `work` of a cut that is turned as a whole [N]."""
    lower, upper = np.array([-6.5e-3, -6.6e-3, -3e-3]), np.array([8.5e-3, 6.7e-3, 0])
    if radial_depth < 2 * RADIUS:
        # The raw face of a half immersion goes through the axis.
        lower[1] = 0.0
    corners = turn.apply(box_corners(lower, upper))
    stock = dm.workpiece.from_mesh(hexahedron(corners), SPACING, interval_counts=SLOTS)
    path, first = straight([-1.5e-3, 0.0, -DEPTH], FEED * ALONG)
    size = float(np.linalg.norm(upper - lower))
    solution = cut(
        turn.apply(path),
        stock,
        mill(kind),
        turn.apply(UP),
        axial_depth=size,
    )
    return mean_force(solution, first)
