"""Whether a table of load tests would suit the robot much better with other axes.

Two mistakes are looked for: a displacement in other axes than the load, and both in
the same axes, but not in those of the robot's base.
"""

import itertools
from collections.abc import Callable, Iterator

import numpy as np
from jaxtyping import Float

from ._groups import Columns, Values, nonnegative, trimmed_start

# Other axes are proposed if they lower the squared residual by this factor.
_BETTER_AXES = 3.0
# Where next to nothing is left to explain, nothing can be much better.
_ALL_EXPLAINED = 0.999
_STARTS = 20

Turn = Float[np.ndarray, "3 3"]
Loads = Float[np.ndarray, "pose 6"]


def better_axes(
    columns_of: Callable[[Loads], Columns],
    load: Loads,
    moved: Values,
    explained: float,
) -> str | None:
    """Return an assignment of the axes that suits much better, if there is one.

    Args:
        columns_of: Returns displacement per compliance for loads [N, N m], shape
            (pose, component, joint).
        load: The loads, shape (pose, 6).
        moved: The displacements, shape (pose, component).
        explained: Share of their square that the fit explains.

    Returns:
        What is to be read how, such as "the displacement read as (x, -y, z)"; None if
        nothing is much better, or displacements are missing.

    **Differentiability**: none, a host function.
    """
    if not np.all(np.isfinite(moved)) or explained > _ALL_EXPLAINED:
        return None
    columns = columns_of(load)
    best, found = _cost(columns, moved) / _BETTER_AXES, None
    for name, T in _turns():
        both = np.linalg.det(T) * T
        cases = (
            (columns, _turned(moved, T, T), "the displacement"),
            # Moments and rotations of mirrored axes change their sign once more.
            (
                columns_of(_turned(load, T, both)),
                _turned(moved, T, both),
                "load and displacement both",
            ),
        )
        for turned_columns, turned, what in cases:
            cost = _cost(turned_columns, turned)
            if cost < best:
                best, found = cost, f"{what} read as {name}"
    return found


def _cost(columns: Columns, moved: Values) -> float:
    """Return the squared residual of the poses that agree best."""
    is_free = np.zeros(columns.shape[2], bool)
    kept = trimmed_start(columns, moved, is_free, starts=_STARTS)
    rows = columns[kept].reshape(-1, columns.shape[2])
    right = moved[kept].reshape(-1)
    return float(np.sum((right - rows @ nonnegative(rows, right, is_free)) ** 2))


def _turns() -> Iterator[tuple[str, Turn]]:
    """Return all assignments of three axes with their names, but the plain one."""
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            T = np.eye(3)[list(order)] * np.array(signs)[:, None]
            if np.array_equal(T, np.eye(3)):
                continue
            each = zip(order, signs, strict=True)
            names = [f"{'-' if sign < 0 else ''}{'xyz'[axis]}" for axis, sign in each]
            yield f"({', '.join(names)})", T


def _turned(values: Values, linear: Turn, angular: Turn) -> Values:
    """Return values with their axes turned, linear parts first."""
    parts = [values[:, :3] @ linear.T]
    if values.shape[1] == 6:
        parts.append(values[:, 3:] @ angular.T)
    return np.concatenate(parts, axis=1)
