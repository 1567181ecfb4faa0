"""Mean error, errors by part of the path and cost of each case."""

from html import escape
from typing import TYPE_CHECKING

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .._cases import case_names, place_text, select_case, values_of
from .._style import MICROMETRE, case_style, length_text, number_text
from .html import table_html

if TYPE_CHECKING:
    import xarray

_NEEDED = ("contour_mean", "part_rms", "part_max", "part_rows", "max_acceleration")


class CaseParts(eqx.Module):
    """Figures of one case beyond the headline.

    Attributes:
        name: Name of the case.
        mean: Mean contour vector where the tool cuts [m], shape (3,).
        rms: Root mean square contour error by part of the path [m].
        maximum: Largest contour error by part of the path [m].
        rows: Rows by part of the path.
        max_acceleration: Largest acceleration of the commanded tip [m/s^2].
        seconds: Wall time of the method [s]; NaN where it is not known.
        forward_runs: Simulations that the method needed; 0 where it is not known.
        rows_out_of_cut: Rows where the tool cuts nothing but should be in a full cut.
    """

    name: str = eqx.field(static=True)
    mean: Float[np.ndarray, " 3"]
    rms: dict[str, float]
    maximum: dict[str, float]
    rows: dict[str, int]
    max_acceleration: float
    seconds: float
    forward_runs: int
    rows_out_of_cut: int


def case_parts(dataset: "xarray.Dataset") -> tuple[CaseParts, ...]:
    """Figures by part of the path of all cases; none where the dataset lacks them.

    Args:
        dataset: A result of `correct`.
    """
    if any(name not in dataset for name in _NEEDED):
        return ()
    parts = [str(name) for name in dataset["part"].values]
    cases = []
    for name in case_names(dataset):
        case = select_case(dataset, name)
        rms, largest, rows = (
            np.asarray(case[key], np.float64)
            for key in ("part_rms", "part_max", "part_rows")
        )
        cases.append(
            CaseParts(
                name=name,
                mean=np.asarray(case["contour_mean"], np.float64),
                rms=dict(zip(parts, rms.tolist(), strict=True)),
                maximum=dict(zip(parts, largest.tolist(), strict=True)),
                rows=dict(zip(parts, rows.astype(int).tolist(), strict=True)),
                max_acceleration=float(case["max_acceleration"]),
                seconds=float(dataset.attrs.get(f"{name}_wall_time_s", np.nan)),
                forward_runs=int(dataset.attrs.get(f"{name}_forward_runs", 0)),
                rows_out_of_cut=int(case.get("rows_out_of_cut", 0)),
            )
        )
    return tuple(cases)


def out_of_cut_lines(dataset: "xarray.Dataset") -> list[str]:
    """Sentence for each case whose tool leaves the cut, with count and place.

    Args:
        dataset: A result of `correct`.
    """
    lines = []
    for case in case_parts(dataset):
        count = case.rows_out_of_cut
        if not count:
            continue
        text = (
            f"{case.name}: the tool leaves the cut in {count} step{'s' * (count > 1)}"
        )
        text += " where it should be in a full cut"
        if "is_out_of_cut" in dataset:
            is_out = values_of(dataset, "is_out_of_cut", case.name) > 0.5
            error = np.abs(values_of(dataset, "contour_error", case.name))[is_out]
            text += f", first {place_text(dataset, case.name, int(np.argmax(is_out)))}"
            text += f", with a contour error of up to {length_text(np.nanmax(error))}"
        lines.append(
            f"{text}: the teeth behind such a gap take thicker chips, and the wall "
            "keeps a mark"
        )
    return lines


def parts_html(dataset: "xarray.Dataset") -> str:
    """Table of the figures by part with its explanation; or nothing."""
    cases = case_parts(dataset)
    if not cases:
        return ""
    parts = [part for part, rows in cases[0].rows.items() if rows]
    header = ["case", f"mean x, y, z [{MICROMETRE}]"]
    header += [f"{part}: rms / max [{MICROMETRE}]" for part in parts]
    header.append("command's acceleration, max [m/s\u00b2]")
    header.append("steps out of the cut")
    rows = [
        [
            case_style(case.name).label,
            ", ".join(number_text(1e6 * value) for value in case.mean),
            *(
                f"{number_text(1e6 * case.rms[part])} / "
                f"{number_text(1e6 * case.maximum[part])}"
                for part in parts
            ),
            f"{case.max_acceleration:.2f}",
            f"{case.rows_out_of_cut}",
        ]
        for case in cases
    ]
    counts = ", ".join(f"{part} {cases[0].rows[part]}" for part in parts)
    note = (
        "Mean: of the vector from the desired line to the tool tip, its constant part. "
        "Entry, exit: within a tool radius of travel after the cut begins or grows by "
        "a quarter, before it ends or after it shrinks so; corner: the desired line "
        "turns by more than 10\u00b0 within half a radius to either side; plateau: the "
        f"rest. Steps in each: {counts}. Out of the cut: of the corner and plateau, "
        "where nothing pushes the tool though it moves and a rigid one is in a full "
        "cut."
    )
    table = table_html(
        header, rows, colours=[case_style(case.name).colour for case in cases]
    )
    lines = "".join(
        f'<p class="note">{escape(line)}.</p>' for line in out_of_cut_lines(dataset)
    )
    return f'{table}<p class="note">{note}</p>{lines}'


def surface_figures(dataset: "xarray.Dataset") -> dict[str, dict[str, float]]:
    """Figures of the machined surface's error by case [m], walls and floors apart."""
    if "surface_deepest" not in dataset:
        return {}
    kinds = [kind for kind in ("wall", "floor") if f"surface_{kind}_rms" in dataset]
    keys = [f"{kind}_{key}" for kind in kinds for key in ("mean", "rms", "p95")]
    if not keys:
        return {}
    return {
        name: {
            key: float(select_case(dataset, name)[f"surface_{key}"])
            for key in (*keys, "deepest")
        }
        for name in case_names(dataset)
    }


def surface_figures_html(dataset: "xarray.Dataset") -> str:
    """Table of the machined surface's error, walls and floors apart."""
    figures = surface_figures(dataset)
    if not figures:
        return ""
    names = list(figures)
    titles = {"rms": "rms", "p95": "95 %", "deepest": "deepest cut into the part"}
    header = ["case"]
    for key in figures[names[0]]:
        kind, _, figure = key.rpartition("_")
        header.append(titles.get(figure, f"{kind}: mean [{MICROMETRE}]"))
    rows = []
    for name, values in figures.items():
        text = [number_text(1e6 * value) for value in values.values()]
        rows.append([case_style(name).label, *text])
    note = (
        "Distance of the machined surface from that of a rigid tool, where a tool cut; "
        "positive mean: material left."
    )
    table = table_html(header, rows, colours=[case_style(n).colour for n in names])
    return f'{table}<p class="note">{note}</p>'
