"""Check of the axes of a table of load tests against the robot.

Three mistakes are looked for: a displacement in other axes than those of the robot, a
load in others, and both in the same axes, but not in those of the robot.
"""

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from .._alignment.axis_assignment import signed_permutations
from .._alignment.axis_proposal import axes_names
from .._statistics.grouped_nnls import Columns, Values, nonnegative, trimmed_start

# Other axes are proposed if they lower the squared residual by this factor.
_BETTER_AXES = 3.0
# Where next to nothing is left to explain, nothing can be much better.
_ALL_EXPLAINED = 0.999
_STARTS = 20
# Residuals that differ by less than this share of them are alike.
_ALIKE = 1e-6

Turn = Float[np.ndarray, "3 3"]
Turns = Float[np.ndarray, "pose 3 3"]
Loads = Float[np.ndarray, "pose 6"]


@dataclasses.dataclass(frozen=True)
class AxesCheck:
    """Result of the check of a table's axes.

    Attributes:
        better: Reading that would suit much better, such as "the displacement read as
            (x, -y, z)"; None if there is none.
        is_possible: Whether enough rows have all components for a check.
    """

    better: str | None
    is_possible: bool


def better_axes(
    columns_of: Callable[[Loads], Columns],
    load: Loads,
    moved: Values,
    explained: float,
    load_frame: Turns | None = None,
) -> AxesCheck:
    """Assignment of the axes that suits much better, if there is one.

    Args:
        columns_of: Returns displacement per compliance for loads [N, N m], shape
            (pose, component, joint), in the axes of `moved`.
        load: The loads in base axes, shape (pose, 6).
        moved: The displacements as recorded, shape (pose, component); rows with a
            missing component do not count.
        explained: Share of their square that the fit explains.
        load_frame: Rotations into base of the frame in which the load was recorded,
            whose axes are exchanged, shape (pose, 3, 3); None for base.

    Returns:
        The assignment.
    """
    if explained > _ALL_EXPLAINED:
        return AxesCheck(None, True)
    whole = np.isfinite(moved).all(axis=1)
    columns, seen = columns_of(load)[whole], moved[whole]
    if seen.size <= columns.shape[2]:
        return AxesCheck(None, False)
    best, better = _cost(columns, seen) / _BETTER_AXES, None
    # Turned and mirrored axes say the same of forces alone: turns come first.
    for T in sorted(signed_permutations(), key=lambda T: np.linalg.det(T) < 0):
        if np.array_equal(T, np.eye(3)):
            continue
        # Moments and rotations of mirrored axes change their sign once more.
        both = np.linalg.det(T) * T
        other = columns_of(_turned(load, T, both, load_frame))[whole]
        turned = _turned(seen, T, both, None)
        cases = (
            (columns, turned, "the displacement"),
            (other, seen, "the load"),
            (other, turned, "load and displacement both"),
        )
        for one, values, what in cases:
            cost = _cost(one, values)
            if cost < (1 - _ALIKE) * best:
                best, better = cost, f"{what} read as ({', '.join(axes_names(T))})"
    return AxesCheck(better, True)


def _cost(columns: Columns, moved: Values) -> float:
    """Squared residual of the poses that agree best."""
    is_free = np.zeros(columns.shape[2], bool)
    agreed = trimmed_start(columns, moved, is_free, starts=_STARTS)
    rows = columns[agreed].reshape(-1, columns.shape[2])
    right = moved[agreed].reshape(-1)
    return float(np.sum((right - rows @ nonnegative(rows, right, is_free)) ** 2))


def _turned(values: Values, linear: Turn, angular: Turn, frame: Turns | None) -> Values:
    """Values with the axes of their frame turned, linear parts first."""
    parts = values.reshape(len(values), -1, 3)
    if frame is not None:
        parts = np.einsum("pji,pkj->pki", frame, parts)
    turns = np.stack([linear, angular])[: parts.shape[1]]
    parts = np.einsum("kij,pkj->pki", turns, parts)
    if frame is not None:
        parts = np.einsum("pij,pkj->pki", frame, parts)
    return parts.reshape(values.shape)
