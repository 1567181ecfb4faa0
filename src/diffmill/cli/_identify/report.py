"""Report of an identification, and lines that several kinds of it print."""

import dataclasses
import itertools
import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_WIDTH = 88


@dataclasses.dataclass(frozen=True)
class Report:
    """Report of an identification.

    Attributes:
        lines: The summary for the terminal.
        toml: Lines of job tables.
        facts: Everything as numbers and texts, for `identified.json`.
        figures: Functions that draw the figures, by the names of their files without
            suffix.
    """

    lines: list[str]
    toml: list[str]
    facts: dict[str, object]
    figures: Mapping[str, Callable[[], "Figure"]]


def noted(text: str, mark: str = "note") -> list[str]:
    """Lines of a sentence behind a mark."""
    return textwrap.wrap(
        text, _WIDTH, initial_indent=f"{mark}: ", subsequent_indent="  "
    )


def all_noted(texts: Sequence[str], mark: str = "note") -> list[str]:
    """Lines of sentences, each behind a mark."""
    return [line for text in texts for line in noted(text, mark)]


def coefficient_lines(
    coefficients: Mapping[str, float],
    raw: Mapping[str, float],
    errors: Mapping[str, float],
    identifiable: Mapping[str, bool],
) -> list[str]:
    """Table of force coefficients.

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
    """Sentences about pairs of parameters that are hard to tell from each other."""
    lines = []
    for i, j in itertools.combinations(range(len(names)), 2):
        value = correlation[i, j]
        if np.isfinite(value) and abs(value) > 0.9:
            lines += noted(
                f"{names[i]} and {names[j]} are hard to tell apart (correlation "
                f"{value:.3f})."
            )
    return lines


def uncertainty_remark(
    names: Sequence[str], known: Bool[np.ndarray, " name"]
) -> str | None:
    """Joints that an uncertainty does not include, as a remark; None if it has all.

    Args:
        names: Of the joints.
        known: Which of them were identified, shape (name,).
    """
    unknown = [name for name, is_so in zip(names, known, strict=True) if not is_so]
    if not unknown:
        return None
    return f"without the error of {', '.join(unknown)}: as in the model, maybe far off"


def force_on_text(axes: Sequence[str], force_on: str | None) -> str:
    """Body on which the recorded forces are taken to act, and doubts of it.

    Args:
        axes: For x, y, z of the work the recorded axis.
        force_on: "workpiece", "tool", or None if the file does not say.
    """
    order = np.eye(3)[["xyz".index(name[-1]) for name in axes]]
    signs = np.array([-1.0 if name.startswith("-") else 1.0 for name in axes])
    is_left_handed = bool(np.linalg.det(signs[:, None] * order) < 0)
    if force_on is not None:
        done = "was reversed first" if force_on == "workpiece" else "was taken as it is"
        hand = "; these axes are left-handed all the same" if is_left_handed else ""
        return f"the recorded force, on the {force_on}, {done}{hand}"
    if not is_left_handed:
        return (
            "that is the force on the tool in right-handed axes; a dynamometer below "
            'the part records that on the workpiece: force_on = "workpiece" in [fit]'
        )
    turned = [n[1:] if n.startswith("-") else f"-{n}" for n in axes]
    return (
        "in right-handed axes that is the force on the workpiece: as force_on = "
        f'"workpiece" with axes = {axes_text(turned)}, or a channel is reversed'
    )


def axes_text(axes: Sequence[str]) -> str:
    """Axes as a TOML list."""
    return "[" + ", ".join(f'"{name}"' for name in axes) + "]"
