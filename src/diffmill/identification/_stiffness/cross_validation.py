"""Cross-validation of joint stiffness on load tests left out of the fit."""

import dataclasses

import numpy as np
from jaxtyping import Float

from ...robot import Robot
from .._statistics.grouped_nnls import nonnegative
from .axis_check import Turns
from .joint_stiffness import (
    JointStiffnessFit,
    Table,
    constant_columns,
    deflection_columns,
    load_tables,
)


@dataclasses.dataclass(frozen=True)
class LoadCheck:
    """Load tests predicted by the others.

    Attributes:
        measured: Displacement without the constant one, shape (pose, component).
        predicted: By springs from the other rows, shape (pose, component); gross
            errors, which were left out, are predicted by all others.
        error: Root mean square of the difference over that of the measured
            displacement, rows that were left out as gross errors apart; linear part;
            NaN where no row is predicted by others.
    """

    measured: Float[np.ndarray, "pose component"]
    predicted: Float[np.ndarray, "pose component"]
    error: float


def check_load_tests(
    robot: Robot,
    fit: JointStiffnessFit,
    q: Table,
    wrench: Table,
    displacement: Table,
    *,
    displacement_frame: Turns | None = None,
    parts: int = 5,
) -> LoadCheck:
    """Predict the rows of a table of load tests by the other rows.

    The table is cut into parts; each is predicted by springs that are fitted to the
    others without the gross errors that the fit names.

    Args:
        robot: The robot.
        fit: The fit to the table.
        q: Joint positions [rad or m], shape (pose, joint).
        wrench: Loads [N, N m], shape (pose, 6) or (pose, 3).
        displacement: As fitted [m, rad], shape (pose, 3) or (pose, 6).
        displacement_frame: Rotations of its axes into base, shape (pose, 3, 3), None
            for base.
        parts: Number of parts; each row by itself if there are fewer rows.

    Returns:
        The predictions.

    Raises:
        ValueError: A table has a wrong shape.
    """
    angles, load, moved = load_tables(robot, q, wrench, displacement)
    columns = deflection_columns(robot, angles, load, displacement_frame)
    columns = columns[:, : moved.shape[1]]
    if fit.offset is not None:
        moved = moved - constant_columns(moved, displacement_frame) @ fit.offset
    good = np.ones(len(moved), bool)
    good[list(fit.outliers)] = False
    # Rotations are as large as displacements if both are over their own size.
    known = np.isfinite(moved)
    square = np.sum(np.where(known, moved, 0.0) ** 2, axis=0)
    scale = np.sqrt(square / np.maximum(known.sum(axis=0), 1))
    scale = np.where(scale > 0, scale, 1.0)
    predicted = np.full_like(moved, np.nan)
    place = np.arange(len(moved)) % min(parts, len(moved))
    free = np.zeros(robot.joint_count, bool)
    for part in np.unique(place):
        rows = good & (place != part)
        if not rows.any():
            continue
        A = (columns[rows] / scale[None, :, None]).reshape(-1, robot.joint_count)
        c = nonnegative(A, (moved[rows] / scale[None]).reshape(-1), free)
        predicted[place == part] = columns[place == part] @ c
    off = (moved - predicted)[good, :3]
    if not np.isfinite(off).any():
        return LoadCheck(moved, predicted, float("nan"))
    size = np.sqrt(np.nansum(np.where(np.isfinite(off), moved[good, :3], 0.0) ** 2))
    return LoadCheck(
        moved, predicted, float(np.sqrt(np.nansum(off**2)) / max(size, 1e-300))
    )
