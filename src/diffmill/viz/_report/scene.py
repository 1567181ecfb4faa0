"""The turning view of arm, part and path, and the data of its script."""

import base64
import itertools
import json
from collections.abc import Set
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from jaxtyping import Float, Int

from ..._job import Job
from ...robot import Skeleton
from ...workpiece import SurfaceError
from .._cases import case_names, cutting_of, reference_case, select_case, values_of
from .._figure.robot import arm_lines
from .._style import case_style, round_factor, spread

if TYPE_CHECKING:
    import xarray

_SCRIPT = Path(__file__).with_name("page.js")
# Limits of a screen, and of a file of a few megabytes.
_MOST_ROWS, _MOST_POINTS, _MOST_FRAMES = 2000, 16_000, 120


def scene_html(
    dataset: "xarray.Dataset",
    chosen: str,
    *,
    surfaces: dict[str, SurfaceError] | None = None,
    job: Job | None = None,
    band: float = 0.0,
) -> str:
    """Return the view with the history below it and the script that moves both.

    Args:
        dataset: A result of `simulate` or `correct`.
        chosen: Case to show at first.
        surfaces: Surface error by case, for the colours of the part.
        job: For the arm, the tool and the raw part.
        band: Contour error to mark in the history [m]; 0 for none.

    Returns:
        The HTML; nothing where the result has no path with errors.
    """
    needed = ("time", "desired", "deviation", "contour_error", "force")
    if dataset.sizes.get("step", 0) < 3 or any(name not in dataset for name in needed):
        return ""
    names = case_names(dataset)
    data = _scene_data(dataset, chosen, surfaces=surfaces or {}, job=job)
    data["band"] = band * 1e6
    packed = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    cases = "".join(
        f'<button type="button" data-case="{k}">{escape(case_style(name).label)}'
        "</button>"
        for k, name in enumerate(names)
    )
    views = '<button type="button" data-view="part">part</button>' + (
        '<button type="button" data-view="arm">whole arm</button>'
        if data["arm"]
        else ""
    )
    legend = (
        '<div class="scale" id="legend"><span></span>'
        '<i style="background:linear-gradient(90deg,#2166ac,#67a9cf,#f7f7f7,#ef8a62,'
        '#b2182b)"></i><span></span></div>'
    )
    note = (
        "Drag or arrow keys turn; with Ctrl, or after a click, the wheel zooms, as + "
        "and - do. Point at the path or the curves, or move the slider: all show the "
        "same moment."
    )
    return (
        '<div class="view">'
        f'<div class="row screen">{cases}</div><div class="row screen">{views}</div>'
        '<canvas id="scene" tabindex="0" role="img" aria-label="Arm, machined part '
        'and path in three dimensions"></canvas>'
        f"{legend}"
        '<canvas id="history" role="img" aria-label="Contour error and force over '
        'time"></canvas>'
        '<input class="screen" id="moment" type="range" min="0" '
        f'max="{data["rows"] - 1}" aria-label="moment">'
        '<output id="readout" for="moment"></output>'
        f'<p class="note screen">{note}</p></div>'
        f'<script type="application/json" id="run-data">{packed}</script>'
        f"<script>{_SCRIPT.read_text(encoding='utf-8')}</script>"
    )


def _scene_data(
    dataset: "xarray.Dataset",
    chosen: str,
    *,
    surfaces: dict[str, SurfaceError],
    job: Job | None,
) -> dict[str, Any]:
    """Data that the script draws, in mm, um and N, about the middle of the part."""
    names, reference = case_names(dataset), reference_case(dataset)
    rows = _shown_rows(dataset, {reference, chosen})
    desired = values_of(dataset, "desired", reference)[rows]
    known = [item.points for item in surfaces.values()] or [desired]
    if job is not None:
        known = [job.stock.ray_ends(family).points for family in range(3)]
    corners = np.concatenate(known)
    low, high = corners.min(axis=0), corners.max(axis=0)
    middle = 0.5 * (low + high)
    square = _square(next(iter(surfaces.values()))) if surfaces else 0.0
    grain = float(np.ptp([low, high], axis=0).max()) / 2**16 * 1.2
    cases = []
    for name in names:
        part = select_case(dataset, name)
        limit = spread(surfaces[name].error, 99.0) if name in surfaces else 0.0
        series = {
            key: np.asarray(part[key].transpose("step", ...).values, np.float64)[rows]
            for key in ("deviation", "contour_error", "force")
        }
        cases.append(
            {
                "label": case_style(name).label,
                "colour": case_style(name).colour,
                "deviation": _packed(1e6 * series["deviation"]),
                "error": _packed(1e6 * series["contour_error"]),
                "force": _packed(np.linalg.norm(series["force"], axis=1)),
                "limit": 1e6 * limit,
                "cloud": _cloud(surfaces[name], middle, grain, square, limit)
                if name in surfaces
                else None,
            }
        )
    cutting = cutting_of(dataset, reference)[rows]
    off = spread(values_of(dataset, "deviation", chosen)[rows][cutting], 99.0)
    span = float(np.max(high - low))
    return {
        "rows": len(rows),
        "time": _packed(values_of(dataset, "time", reference)[rows]),
        "desired": _packed(1e3 * (desired - middle)),
        "cutting": _encoded(cutting.astype(np.uint8)),
        "cases": cases,
        "chosen": names.index(chosen),
        "reference": names.index(reference),
        "worst": int(np.argmax(_sizes(dataset, chosen)[rows])),
        # The largest deviation is drawn as long as a fortieth of the part.
        "factor": round_factor(span / 40 / max(off, 1e-9)),
        "square": 1e3 * square,
        "grain": 1e3 * grain,
        "origin": (1e3 * middle).tolist(),
        "lower": (1e3 * (low - middle)).tolist(),
        "upper": (1e3 * (high - middle)).tolist(),
        "turn": (np.eye(3) if job is None else _turn(job)).tolist(),
        "radius": 0.0 if job is None else 1e3 * float(job.cutter.nominal_radius),
        "arm": _arm(dataset, chosen, job, middle, rows),
    }


def _shown_rows(
    dataset: "xarray.Dataset", cases: Set[str]
) -> Int[np.ndarray, " shown"]:
    """Return rows to show: of each stretch the worst of each case, and both ends."""
    count = dataset.sizes["step"]
    if count <= _MOST_ROWS:
        return np.arange(count)
    edges = np.linspace(0, count, _MOST_ROWS // len(cases) + 1).astype(int)
    worst = [
        low + int(np.argmax(sizes[low:high]))
        for sizes in (_sizes(dataset, case) for case in cases)
        for low, high in itertools.pairwise(edges)
    ]
    return np.unique([0, *worst, count - 1])


def _sizes(dataset: "xarray.Dataset", case: str) -> Float[np.ndarray, " step"]:
    """Return sizes of the contour error [m], below 0 where the tool does not cut."""
    error = np.abs(np.nan_to_num(values_of(dataset, "contour_error", case)))
    return np.where(cutting_of(dataset, case), error, -1.0)


def _square(item: SurfaceError) -> float:
    """Return the side of the squares that show a surface [m]."""
    pitches = [1e-4]
    for family in range(3):
        points = item.points[item.family == family]
        for axis in {0, 1, 2} - {family}:
            lines = np.unique(np.round(points[:, axis], 7))
            if len(lines) > 2:
                pitches.append(float(np.median(np.diff(lines))))
    side = max(pitches)
    while len(_one_each(item.points, side)) > _MOST_POINTS:
        side *= 1.2
    return side


def _one_each(
    points: Float[np.ndarray, "n 3"], side: float
) -> Int[np.ndarray, " shown"]:
    """Return the index of one point for each cube with this side that holds any.

    All of them if they are few enough as they are.
    """
    if len(points) <= _MOST_POINTS:
        return np.arange(len(points))
    cubes = np.floor(points / side + 1e-6).astype(np.int64)
    return np.sort(np.unique(cubes, axis=0, return_index=True)[1])


def _cloud(
    item: SurfaceError,
    middle: Float[np.ndarray, " 3"],
    grain: float,
    square: float,
    limit: float,
) -> dict[str, str]:
    """Return a surface for the screen: places, share of the colour scale, normals."""
    shown = _one_each(item.points, square)
    share = np.clip(item.error[shown] / max(limit, 1e-12), -1, 1)
    return {
        "points": _encoded(
            np.round((item.points[shown] - middle) / grain).astype(np.int16)
        ),
        "error": _encoded(np.round(127 * share).astype(np.int8)),
        "normal": _encoded(np.round(127 * item.normal[shown]).astype(np.int8)),
    }


def _turn(job: Job) -> Float[np.ndarray, "3 3"]:
    return np.asarray(job.T_base_work, np.float64)[:3, :3]


def _arm(
    dataset: "xarray.Dataset",
    case: str,
    job: Job | None,
    middle: Float[np.ndarray, " 3"],
    rows: Int[np.ndarray, " shown"],
) -> dict[str, Any] | None:
    """Return the arm's lines at equal steps of the rows shown, in axes of the work."""
    if job is None or job.robot is None or "joint_positions" not in dataset:
        return None
    joints = values_of(dataset, "joint_positions", case)[rows]
    at = np.linspace(0, len(joints) - 1, min(len(joints), _MOST_FRAMES))
    robot = job.robot
    of_joints = jax.jit(jax.vmap(lambda q: Skeleton.of_robot(robot, q)))
    bones = jax.tree.map(np.asarray, of_joints(joints[at.astype(int)]))
    frames = [
        np.stack(arm_lines(robot, jax.tree.map(lambda leaf, k=k: leaf[k], bones)))
        for k in range(len(at))
    ]
    origin = np.asarray(job.T_base_work, np.float64)[:3, 3]
    # Rows times R are the columns R^T p: from the base into the work.
    placed = (np.stack(frames) - origin) @ _turn(job) - middle
    return {
        "frames": len(frames),
        "lines": placed.shape[1],
        "points": _packed(1e3 * placed),
    }


def _packed(values: Float[np.ndarray, "..."]) -> str:
    """Return numbers in single precision as text; what is not finite is 0."""
    finite = np.nan_to_num(values, posinf=0.0, neginf=0.0)
    return _encoded(finite.astype("<f4"))


def _encoded(values: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")
