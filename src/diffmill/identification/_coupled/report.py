"""Report of a fit to a coupled record: what it explains, what is unidentifiable."""

import numpy as np
from jaxtyping import Bool, Float

from ...optimise import LeastSquaresState
from .._statistics.robust_regression import LinearFit

# Parameters are confused with each other from this correlation on.
_CONFUSED = 0.9
# Below this share of the square the record is called badly explained.
EXPLAINED = 0.7


def explained_by(
    measured: dict[str, np.ndarray | None],
    fit: LinearFit,
    offset: Float[np.ndarray, " 3"] | None,
) -> dict[str, float]:
    """Share of the square of each measurement that a fit explains, by its name.

    Args:
        measured: "force" and "deviation", shape (row, 3) each, or None.
        fit: The fit of those that there are, in this order.
        offset: Constant part of the deviation [m], shape (3,), or None.
    """
    seen = {name: rows for name, rows in measured.items() if rows is not None}
    explained = {}
    for (name, rows), off in zip(seen.items(), fit.residual, strict=True):
        level = np.zeros(3) if name == "force" or offset is None else offset
        known = np.isfinite(off)
        square = float(np.sum((rows - level[None])[known] ** 2))
        residual = float(np.sum(off[known] ** 2))
        explained[name] = 1.0 - residual / max(square, 1e-300)
    return explained


def coupled_notes(
    names: tuple[str, ...],
    is_fixed: Bool[np.ndarray, " parameter"],
    correlation: Float[np.ndarray, "parameter parameter"],
    explained: dict[str, float],
    solution: LeastSquaresState,
) -> tuple[str, ...]:
    """Sentences about doubts and about parameters that are not identifiable.

    Args:
        names: Of the parameters.
        is_fixed: Which are identifiable, shape (parameter,).
        correlation: Between them, shape (parameter, parameter); may have NaN.
        explained: Share of the squares, by what was measured.
        solution: The fit.

    Returns:
        Sentences, none if all is well.
    """
    notes = []
    if not solution.has_converged:
        notes.append(
            f"The fit has not converged after {solution.evaluations} simulations: "
            "start nearer, or fit fewer parameters."
        )
    for name, share in explained.items():
        if share < EXPLAINED:
            notes.append(
                f"The fit explains {max(share, 0.0):.0%} of the squared {name}, less "
                f"than {EXPLAINED:.0%}: the record does not suit the job (axes, "
                "units, signs, clock, or a path that was not run)."
            )
    for i in np.flatnonzero(~is_fixed):
        others = np.abs(np.nan_to_num(correlation[i]))
        others[i] = 0.0
        j = int(np.argmax(others))
        why = "add deeper cuts, and the force to the record"
        if names[i].startswith("K "):
            why = "cut where the force turns this joint more, or load it at rest"
        elif names[i].startswith("D "):
            why = "record this joint ringing: starts, stops, corners, or a ring-down"
        elif names[i].endswith("e"):
            why = "add cuts at other feeds per tooth, and the force to the record"
        if others[j] > _CONFUSED:
            why = f"it cannot be distinguished from {names[j]}; {why}"
        notes.append(f"{names[i]} is not identifiable: {why}.")
    return tuple(notes)
