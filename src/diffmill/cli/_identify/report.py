"""Report of an identification, and lines that several kinds of it print."""

import dataclasses
import itertools
import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

from .rounded import Rounded

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ...viz import StudyTable

_WIDTH = 88


@dataclasses.dataclass(frozen=True)
class Report:
    """Report of an identification.

    Attributes:
        lines: The summary for the terminal; notes and warnings are a line each.
        toml: Lines of job tables.
        facts: Everything as numbers and texts, for `identified.json`.
        figures: Functions that draw the figures, by the names of their files without
            suffix.
        estimates: The values that were sought.
        assumptions: What is assumed, in sentences.
    """

    lines: list[str]
    toml: list[str]
    facts: dict[str, object]
    figures: Mapping[str, Callable[[], "Figure"]]
    estimates: Sequence["EstimatedValue"]
    assumptions: Sequence[str]

    @property
    def text(self) -> str:
        """Summary for the terminal, long notes in several lines."""
        return "\n".join(
            "\n".join(textwrap.wrap(line, _WIDTH, subsequent_indent="  "))
            if line.startswith(("note: ", "warning: "))
            else line
            for line in self.lines
        )

    def marked(self, mark: str) -> list[str]:
        """Sentences behind a mark, "note" or "warning"."""
        head = f"{mark}: "
        return [x.removeprefix(head) for x in self.lines if x.startswith(head)]


@dataclasses.dataclass(frozen=True)
class EstimatedValue:
    """A value that was sought.

    Attributes:
        name: Name of the quantity.
        value: The value; NaN if the measurements do not show it.
        error: Its standard error; NaN if it is not known.
        unit: Unit of both.
        remark: What else is known, such as a bound.
    """

    name: str
    value: float
    error: float
    unit: str
    remark: str = ""

    @property
    def is_known(self) -> bool:
        """True if the measurements show it."""
        return math.isfinite(self.value)


def estimate_table(estimates: Sequence[EstimatedValue]) -> "StudyTable":
    """Table of values with standard errors and 95 % intervals.

    Args:
        estimates: The values.
    """
    # What takes seconds to import waits until it is needed.
    from ...viz import StudyTable

    rows = []
    for one in estimates:
        cells, remark = ("-", "-", "-"), one.remark
        if not one.is_known:
            remark = "; ".join(filter(None, ["not identifiable", remark]))
        else:
            value, error = Rounded.of(one.value, one.error)
            ends = (one.value + s * 1.96 * one.error for s in (-1, 1))
            interval = " to ".join(Rounded.of(x, one.error).value for x in ends)
            cells = (value, error, interval if math.isfinite(one.error) else "-")
        rows.append((one.name, *cells, one.unit, remark))
    header = ("quantity", "value", "standard error", "95 %", "unit", "remark")
    if not any(remark for *_, remark in rows):
        header, rows = header[:-1], [row[:-1] for row in rows]
    return StudyTable("Estimates", header, tuple(rows))


def noted(text: str, mark: str = "note") -> list[str]:
    """Line of a sentence behind a mark."""
    return [f"{mark}: {text}"]


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


def coefficient_estimates(
    raw: Mapping[str, float],
    errors: Mapping[str, float],
    identifiable: Mapping[str, bool],
) -> list[EstimatedValue]:
    """Force coefficients in the units of tables.

    Args:
        raw: As fitted, identifiable or not, by name [Pa, N/m].
        errors: Standard errors.
        identifiable: Whether each is known.
    """
    estimates = []
    for name, value in raw.items():
        unit, scale = ("N/mm^2", 1e-6) if name.endswith("c") else ("N/mm", 1e-3)
        number = scale * value if identifiable[name] else math.nan
        estimates.append(EstimatedValue(name, number, scale * errors[name], unit))
    return estimates


def correlation_lines(
    names: Sequence[str], correlation: Float[np.ndarray, "name name"]
) -> list[str]:
    """Sentences about pairs of parameters that are hard to tell from each other."""
    lines = []
    for i, j in itertools.combinations(range(len(names)), 2):
        value = correlation[i, j]
        if np.isfinite(value) and abs(value) > 0.9:
            lines += noted(
                f"{names[i]} and {names[j]} are hard to distinguish (correlation "
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
