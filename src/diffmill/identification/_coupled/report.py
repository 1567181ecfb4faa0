"""Report of a fit to a coupled record: what it explains, what is unidentifiable."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...optimise import LeastSquaresState
from .._statistics.robust_regression import LinearFit

# Parameters are confused with each other from this correlation on.
_CONFUSED = 0.9
# Below this share of the square the record is called badly explained.
EXPLAINED = 0.7


class ExplainedRecord(NamedTuple):
    """What a fit explains of a record, by the name of what was measured.

    Attributes:
        share: Share of the squares that it explains.
        residual_rms: Root mean square of the residual [N or m].
    """

    share: dict[str, float]
    residual_rms: dict[str, float]


def explained_by(
    measured: dict[str, np.ndarray | None],
    fit: LinearFit,
    offset: Float[np.ndarray, " 3"] | None,
) -> ExplainedRecord:
    """Return what a fit explains of a record.

    Args:
        measured: "force" and "deviation", shape (row, 3) each, or None.
        fit: The fit of those that there are, in this order.
        offset: Constant part of the deviation [m], shape (3,), or None.
    """
    seen = {name: rows for name, rows in measured.items() if rows is not None}
    explained, left = {}, {}
    for (name, rows), off in zip(seen.items(), fit.residual, strict=True):
        level = np.zeros(3) if name == "force" or offset is None else offset
        known = np.isfinite(off)
        square = float(np.sum((rows - level[None])[known] ** 2))
        rest = float(np.sum(off[known] ** 2))
        explained[name] = 1.0 - rest / max(square, 1e-300)
        left[name] = float(np.sqrt(rest / max(1, int(known.sum()))))
    return ExplainedRecord(explained, left)


def coupled_notes(
    names: tuple[str, ...],
    is_fixed: Bool[np.ndarray, " parameter"],
    correlation: Float[np.ndarray, "parameter parameter"],
    explained: dict[str, float],
    found: LeastSquaresState,
) -> tuple[str, ...]:
    """Say what the numbers alone do not.

    Args:
        names: Of the parameters.
        is_fixed: Which are identifiable, shape (parameter,).
        correlation: Between them, shape (parameter, parameter); may have NaN.
        explained: Share of the squares, by what was measured.
        found: The fit.

    Returns:
        Sentences, none if all is well.
    """
    notes = []
    if not found.has_converged:
        notes.append(
            f"The fit has not converged after {found.evaluations} simulations: "
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
        why = _unseen(names[i])
        if others[j] > _CONFUSED:
            why = f"it cannot be told from {names[j]}; {why}"
        notes.append(f"{names[i]} is not identifiable: {why}.")
    return tuple(notes)


def _unseen(name: str) -> str:
    """Say which record would show a parameter."""
    if name.startswith("K "):
        return "cut where the force turns this joint more, or load it at rest"
    if name.startswith("D "):
        return "record this joint ringing: starts, stops, corners, or a ring-down"
    if name.endswith("e"):
        return "add cuts at other feeds per tooth, and the force to the record"
    return "add deeper cuts, and the force to the record"
