"""Lines of text that several identifications print."""

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float

from .report import noted


def coefficient_lines(
    coefficients: Mapping[str, float],
    raw: Mapping[str, float],
    errors: Mapping[str, float],
    identifiable: Mapping[str, bool],
) -> list[str]:
    """Return a table of force coefficients.

    Args:
        coefficients: By name [Pa, N/m]; NaN if not identifiable.
        raw: As fitted, identifiable or not.
        errors: Standard errors.
        identifiable: Whether each is known.
    """
    lines = [f"{'coefficient':14}{'value':>12}{'std. error':>12}  unit"]
    for name in coefficients:
        unit, scale = ("N/mm^2", 1e-6) if name.endswith("c") else ("N/mm", 1e-3)
        error = scale * errors[name]
        text = f"{error:12.3g}" if np.isfinite(error) else f"{'unknown':>12}"
        lost = "" if identifiable[name] else "   not identifiable"
        lines.append(f"{name:14}{scale * raw[name]:12.5g}{text}  {unit}{lost}")
    return lines


def correlation_lines(
    names: Sequence[str], correlation: Float[np.ndarray, "name name"]
) -> list[str]:
    """Return sentences about pairs that are hard to tell from each other."""
    lines = []
    for i, j in itertools.combinations(range(len(names)), 2):
        value = correlation[i, j]
        if np.isfinite(value) and abs(value) > 0.9:
            lines += noted(
                f"{names[i]} and {names[j]} are hard to tell apart (correlation "
                f"{value:.3f})."
            )
    return lines


def kept_remark(names: Sequence[str], known: Bool[np.ndarray, " name"]) -> str | None:
    """Return what an uncertainty does not hold for, None if it holds for all.

    Args:
        names: Of the joints.
        known: Which of them were identified, shape (name,).
    """
    kept = [name for name, is_known in zip(names, known, strict=True) if not is_known]
    if not kept:
        return None
    return f"without the error of {', '.join(kept)}: as in the model, maybe far off"


def axes_text(axes: Sequence[str]) -> str:
    """Return axes as a TOML list."""
    return "[" + ", ".join(f'"{name}"' for name in axes) + "]"
