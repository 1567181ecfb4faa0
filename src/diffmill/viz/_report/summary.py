"""The headline figures of a result as text."""

from typing import TYPE_CHECKING, Literal

import numpy as np

from .._cases import case_names, case_numbers, is_diverging
from .._style import MICROMETRE
from .case_parts import case_parts, out_of_cut_lines, surface_figures
from .verdict import departure_text, unsettled_text, verdict

if TYPE_CHECKING:
    import xarray


def summary(
    dataset: "xarray.Dataset", only: Literal["figures", "verdict"] | None = None
) -> str:
    """Return tables of the headline figures and the verdict on a tolerance.

    Args:
        dataset: A result of `simulate` or `correct`.
        only: The part that is returned: the figures of each case and by part of the
            path, or the verdict, empty where no tolerance was stated; both if None.
    """
    if only == "verdict":
        return "\n".join(_verdict(dataset))
    name = dataset.attrs.get("job", "job")
    rows = [f"{name}: contour error where the tool cuts [um], force [N]"]
    rows.append(f"{'case':16}{'rms':>10}{'95 %':>10}{'max':>10}{'mean force':>12}")
    for case in case_names(dataset):
        numbers = case_numbers(dataset, case)
        contour = numbers.contour
        errors = "".join(
            _cell(value * 1e6, 10) for value in (contour.rms, contour.p95, contour.max)
        )
        mark = "  diverges" if is_diverging(dataset, case) else ""
        rows.append(f"{case:16}{errors}{_cell(numbers.force_mean, 12)}{mark}")
    unsettled = unsettled_text(dataset)
    rows += [*_surface(dataset), *_parts(dataset)]
    if any(is_diverging(dataset, case) for case in case_names(dataset)):
        rows.append(
            "note: the mirror is worse than no correction: it commands the opposite of "
            "the error as if the machine followed at once; one that swings or lags "
            "answers late"
        )
    rows += [f"note: {unsettled}"] if unsettled else []
    return "\n".join(rows if only else [*rows, *_verdict(dataset)])


def _cell(value: float, width: int) -> str:
    """Number as text, or a dash where there is none, as of a path in the air."""
    return f"{value:{width}.2f}" if np.isfinite(value) else f"{'-':>{width}}"


def _verdict(dataset: "xarray.Dataset") -> list[str]:
    """Return the verdict if a tolerance was stated, or the part was cut into."""
    judged, departure = verdict(dataset), departure_text(dataset)
    lines = [] if judged.is_held is None else [f"{judged.title}. {judged.text}"]
    lines += [f"note: {departure}"] if departure else []
    # Not every terminal prints a micro sign.
    return [line.replace(MICROMETRE, "um") for line in lines]


def _surface(dataset: "xarray.Dataset") -> list[str]:
    """Return lines of the machined surface's error of each case."""
    figures = surface_figures(dataset)
    if not figures:
        return []
    keys = next(iter(figures.values()))
    names = [key.replace("_", " ").replace("p95", "95 %") for key in keys]
    rows = [
        "",
        "machined surface against that of a rigid tool [um]; positive mean: material "
        "left, deepest: cut into the part",
        f"{'case':16}{''.join(f'{name:>12}' for name in names)}",
    ]
    for case, values in figures.items():
        cells = "".join(_cell(1e6 * value, 12) for value in values.values())
        rows.append(f"{case:16}{cells}")
    return rows


def _parts(dataset: "xarray.Dataset") -> list[str]:
    """Lines on the mean, the parts of the path and the cost of each case."""
    cases = case_parts(dataset)
    if not cases:
        return []
    parts = [part for part, rows in cases[0].rows.items() if rows]
    head = "".join(f"{part:>10}" for part in parts)
    rows = [
        "",
        "mean vector and rms by part of the path [um], largest acceleration of the "
        "command [m/s^2], simulations",
        f"{'case':16}{'mean x':>9}{'y':>9}{'z':>9}{head}{'accel.':>8}{'runs':>6}"
        f"{'time':>9}",
    ]
    for case in cases:
        mean = "".join(f"{1e6 * value:z9.2f}" for value in case.mean)
        rms = "".join(f"{1e6 * case.rms[part]:10.2f}" for part in parts)
        rows.append(
            f"{case.name:16}{mean}{rms}{case.max_acceleration:8.2f}"
            f"{case.forward_runs:6d}{case.seconds:7.1f} s"
        )
    # Not every terminal prints a micro sign.
    lines = [line.replace(MICROMETRE, "um") for line in out_of_cut_lines(dataset)]
    return [*rows, *(f"warning: {line}" for line in lines)]
