"""The report of a run: one HTML file that needs nothing else.

It reads of a result, besides the variables of `simulate` and `correct`:

- attributes `job` (name), `source` (text of the job file), `notes` (lines), `versions`
  (programs and versions, separated by commas), and, of a run that broke off,
  `incomplete` (1), `incomplete_reason`, `incomplete_time` [s], `incomplete_place` [m];
- attributes `CASE_NAME`, such as `mirror_forward_runs`: the cost and the settings of
  each case, those that end in `_s` in seconds; `corrected_case`: the case whose
  command is the corrected program; `written_rms_SUFFIX` and `written_max_SUFFIX` [m],
  the errors that the program in `corrected.SUFFIX` leaves, and `moved_` and `stream_`
  for those files; `written_untimed_SUFFIX`, why that program may not keep its times;
  `is_successful` (0 marks a run that failed);
  `tolerance_band` [m], the contour error to hold the result against;
  `stability_has_chatter` (1 where vibrations grow), and of those that grow most
  `stability_largest_radius`, `stability_frequency` [Hz]; `mismatch_rms_stiffness` and
  `mismatch_rms_force` [m], the error of the command where these are off by
  `mismatch_share`; `truth_rms_median`, `truth_rms_largest` and `truth_rms_uncorrected`
  [m] on `truth_draws` machines; `learnt_expected_rms` [m], with what parts have left
  unknown of the machine;
- every other attribute is listed as a setting.
"""

import os
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..._job import Job
from ...workpiece import SurfaceError
from .._cases import (
    CaseNumbers,
    case_names,
    case_numbers,
    chosen_case,
    is_diverging,
    position_text,
    reference_case,
    values_of,
)
from .._style import MICROMETRE, case_style, number_text
from .before_loading import LoadingCheck, checks_before_loading
from .case_parts import out_of_cut_lines, parts_html, surface_figures_html
from .html import (
    LargeNumber,
    contents_html,
    image_html,
    items_html,
    numbers_html,
    page_html,
    section_html,
    table_html,
)
from .on_machine import machine_lines
from .scene import scene_html
from .study import StudyReport
from .verdict import (
    departure_text,
    limits,
    loaded_errors,
    tolerance_band,
    verdict,
    written_errors,
)
from .write import FigureFile

if TYPE_CHECKING:
    import xarray

_SPECIAL = (
    "job",
    "source",
    "program",
    "notes",
    "versions",
    "units",
    "is_successful",
    "corrected_case",
    "corrected_outcome",
    "tolerance_band",
    "incomplete",
    "incomplete_reason",
    "incomplete_time",
    "incomplete_place",
)
# Sections that open when the reader asks for them.
_FOLDED = ("Job", "Cost", "Settings", "Versions")
# How a line of a result's notes begins that is a warning.
_WARNING = "warning: "
_PREFIXES = tuple(
    f"{kind}_"
    for kind in (
        *("written", "moved", "stream", "stability", "mismatch", "truth"),
        "learnt",
    )
)


def write_report(
    out_dir: str | os.PathLike,
    dataset: "xarray.Dataset",
    figures: dict[str, FigureFile],
    *,
    surfaces: dict[str, SurfaceError] | None = None,
    job: Job | None = None,
    study: StudyReport | None = None,
) -> Path:
    """Write `report.html` and return its path.

    Args:
        out_dir: Existing folder.
        dataset: A result of `simulate` or `correct`.
        figures: Figures of `write_figures`.
        surfaces: Surface error by case, for the part that can be turned around.
        job: For the arm and the raw part beside it, and for the bounds that limited
            the correction.
        study: What measured parts showed before the run.
    """
    name = str(dataset.attrs.get("job", "job"))
    failure = _failure(dataset)
    kind = (
        "Prediction" if len(case_names(dataset)) == 1 else "Prediction and correction"
    )
    title = f"{name} (incomplete)" if failure else name
    lines = str(dataset.attrs.get("notes", "")).splitlines()
    notes = [line for line in lines if line.strip()]
    warnings = [line for line in notes if line.startswith(_WARNING)]
    notes = [line for line in notes if line not in warnings]
    of_loaded = f"{chosen_case(dataset)}: "
    warnings += [x for x in out_of_cut_lines(dataset) if x.startswith(of_loaded)]
    images = []
    for file in figures.values():
        if file.path is None:
            notes.append(f'No figure "{file.title}": {file.skipped}.')
        else:
            images.append(image_html(file.path, file.title, file.caption))
    source = escape(str(dataset.attrs.get("source", "")).strip())
    versions = str(dataset.attrs.get("versions", "")).split(",")
    pairs = [item.strip().partition(" ") for item in versions if item.strip()]
    costs = _case_attributes(dataset)
    hidden = {*_SPECIAL, *(f"{c}_{key}" for c, cost in costs.items() for key in cost)}
    hidden |= {str(k) for k in dataset.attrs if str(k).startswith(_PREFIXES)}
    listed = {str(k): _cell(v) for k, v in dataset.attrs.items() if k not in hidden}
    bounds = None if job is None else job.correction
    scene = scene_html(
        dataset,
        chosen_case(dataset),
        surfaces=surfaces,
        job=job,
        band=tolerance_band(dataset),
    )
    loading = "" if failure else _checks(checks_before_loading(dataset, job))
    sections = {
        "Where the tool misses": scene,
        "Result": "\n".join(_result_blocks(dataset)),
        **({} if study is None else study.sections()),
        "Before you load it": loading,
        "On the machine": items_html(machine_lines(dataset, job)),
        "What limited the result": items_html(limits(dataset, bounds)),
        "By part of the path": parts_html(dataset),
        "Machined surface": surface_figures_html(dataset),
        "Figures": "\n".join(images),
        "Notes": items_html(notes),
        "Job": f"<pre>{source}</pre>" if source else "",
        "Cost": _cost_table(costs),
        "Settings": _pairs(listed, "setting"),
        "Versions": _pairs({n: v for n, _, v in pairs}, "program"),
    }
    sections = {title: content for title, content in sections.items() if content}
    body = [_head(kind, title, dataset, failure, warnings), contents_html([*sections])]
    body += [
        section_html(title, content, is_folded=title in _FOLDED)
        for title, content in sections.items()
    ]
    path = Path(out_dir) / "report.html"
    page = page_html(f"{title} - diffmill", "\n".join(block for block in body if block))
    path.write_text(page, encoding="utf-8")
    return path


def _checks(checks: Sequence[LoadingCheck]) -> str:
    """Table of checks before a program is loaded."""
    marks = {True: "\u2713", False: "\u2717", None: "\u2610"}
    rows = [[marks[one.is_good], one.name, one.finding] for one in checks]
    legend = (
        "\u2713 nothing speaks against loading, \u2717 something does, \u2610 look at "
        "it yourself."
    )
    table = table_html(["", "check", "finding"], rows, is_text=True)
    return f'{table}<p class="note">{legend}</p>'


def _head(
    kind: str,
    title: str,
    dataset: "xarray.Dataset",
    failure: str,
    warnings: Sequence[str],
) -> str:
    numbers = {name: case_numbers(dataset, name) for name in case_names(dataset)}
    text = [
        "<header>",
        f'<p class="kind">{escape(kind)}</p><h1>{escape(title)}</h1>',
        f'<p class="lead">{escape(_lead(dataset, numbers))}</p>',
    ]
    if failure:
        text.append(
            '<p class="banner bad"><b>This run is incomplete.</b> '
            f"{escape(failure)} What follows ends there; its figures do not describe "
            "the whole job.</p>"
        )
    judged = verdict(dataset, is_complete=not failure)
    mark = {True: " good", False: " bad", None: ""}[judged.is_held]
    text.append(
        f'<p class="banner{mark}" id="verdict"><b>{escape(judged.title)}.</b> '
        f"{escape(judged.text)}</p>"
    )
    if warnings:
        shown = [line.removeprefix(_WARNING) for line in warnings]
        text.append(f'<div class="banner bad" id="warnings">{items_html(shown)}</div>')
    text.append(numbers_html(_headline(dataset, numbers)))
    return "\n".join([*text, "</header>"])


def _lead(dataset: "xarray.Dataset", numbers: dict[str, CaseNumbers]) -> str:
    """Return the run in one sentence."""
    steps = dataset.sizes.get("step", 0)
    time = values_of(dataset, "time", reference_case(dataset))
    span = f"{time[-1] - time[0]:.2f} s of milling" if time.size else "no step"
    before = numbers[reference_case(dataset)]
    text = f"{span}, {steps} tooth periods. The tool misses its desired line by "
    text += f"{_length(before.contour.rms)} (rms while cutting)"
    chosen = _chosen(dataset)
    if chosen:
        after = _length(numbers[chosen].contour.rms)
        text += f"; with the corrected program by {after}"
    for name, rms in written_errors(dataset, "rms").items():
        text += f", as written in {name} by {_length(rms)}"
    return text + "."


def _headline(
    dataset: "xarray.Dataset", numbers: dict[str, CaseNumbers]
) -> list[LargeNumber]:
    """Return the numbers to print large."""
    before = numbers[reference_case(dataset)]
    is_given = "is_commanded" in dataset.attrs
    command = "with the given command" if is_given else "as programmed"
    items = [LargeNumber(_length(before.contour.rms), f"contour error (rms) {command}")]
    chosen = _chosen(dataset)
    if chosen:
        after = numbers[chosen].contour.rms
        text = "contour error (rms) after correction"
        items.append(LargeNumber(_length(after), text))
        items += [
            LargeNumber(_length(rms), f"contour error (rms) of {name}, read and run")
            for name, rms in written_errors(dataset, "rms").items()
        ]
        # The files for the machine count: programs are written to a tolerance.
        largest = float(np.max([after, *loaded_errors(dataset, "rms").values()]))
        whose = "" if largest <= after else " of what is written"
        text = f"smaller contour error{whose}"
        items.append(LargeNumber(_times(before.contour.rms, largest), text))
    else:
        items.append(LargeNumber(_length(before.contour.max), "largest contour error"))
    force = f"{number_text(before.force_mean)} N"
    items.append(LargeNumber(force, "mean cutting force"))
    return items


def _result_blocks(dataset: "xarray.Dataset") -> list[str]:
    """Table of all cases and the meaning of its columns."""
    names = case_names(dataset)
    numbers = [case_numbers(dataset, name) for name in names]
    reference = numbers[names.index(reference_case(dataset))]
    rows = [
        [
            case_style(item.name).label,
            _um(item.contour.rms),
            _um(item.contour.p95),
            _um(item.contour.max),
            _gain(dataset, item, reference),
            _um(item.deviation_rms),
            number_text(item.force_mean),
            number_text(item.force_maximum),
            number_text(item.power_maximum),
            number_text(item.removed_volume * 1e9),
        ]
        for item in numbers
    ]
    rms = np.array([item.contour.rms for item in numbers])
    best = int(np.nanargmin(rms)) if len(names) > 1 and np.isfinite(rms).any() else None
    table = table_html(
        [
            "case",
            f"contour error rms [{MICROMETRE}]",
            f"95 % [{MICROMETRE}]",
            f"max [{MICROMETRE}]",
            "smaller by",
            f"deviation rms [{MICROMETRE}]",
            "mean force [N]",
            "max force [N]",
            "max power [W]",
            "removed [mm\u00b3]",
        ],
        rows,
        colours=[case_style(name).colour for name in names],
        best=best,
    )
    legend = (
        "Contour error: distance of the tool tip from the desired line. Deviation: "
        "distance from the desired point at the same instant. Both, and the mean "
        "force, over the steps that cut; forces are means over a tooth period. Bold: "
        "the smallest rms contour error. A mirror diverges where it leaves more error "
        "than it subtracts."
    )
    blocks = [table, f'<p class="note">{legend}</p>']
    departure = departure_text(dataset)
    return [*blocks, f"<p>{escape(departure)}</p>"] if departure else blocks


def _gain(dataset: "xarray.Dataset", item: CaseNumbers, reference: CaseNumbers) -> str:
    """Ratio of the reference's error to that of a case, as text."""
    if item is reference:
        return "-"
    if is_diverging(dataset, item.name):
        return f"diverges ({_times(reference.contour.rms, item.contour.rms)})"
    return _times(reference.contour.rms, item.contour.rms)


def _chosen(dataset: "xarray.Dataset") -> str:
    """Return the case that became the corrected program; nothing if there is none."""
    name = chosen_case(dataset)
    return name if name != reference_case(dataset) else ""


def _case_attributes(dataset: "xarray.Dataset") -> dict[str, dict[str, str]]:
    """Attributes that begin with the name of a case, by case."""
    # "mirror_iterated_forward_runs" belongs to the longest name that fits.
    names = sorted(case_names(dataset), key=len, reverse=True)
    attributes: dict[str, dict[str, str]] = {name: {} for name in case_names(dataset)}
    for key, value in dataset.attrs.items():
        if key in _SPECIAL:
            continue
        owner = next((n for n in names if str(key).startswith(f"{n}_")), None)
        if owner is not None:
            attributes[owner][str(key)[len(owner) + 1 :]] = _cell(value)
    return attributes


def _cost_table(costs: dict[str, dict[str, str]]) -> str:
    """Table of the cost of each case and of the settings that it chose."""
    keys = list(dict.fromkeys(key for cost in costs.values() for key in cost))
    if not keys:
        return ""
    rows = []
    for key in keys:
        name = key.removesuffix("_s").replace("_", " ")
        is_time = key.endswith("_s") or key == "knot_spacing"
        title = f"{name} [s]" if is_time else name
        rows.append([title, *(cost.get(key, "-") for cost in costs.values())])
    # One column for each case: they are fewer than the rows.
    return table_html(["", *(case_style(case).label for case in costs)], rows)


def _failure(dataset: "xarray.Dataset") -> str:
    """Reason, time and place at which the run broke off; nothing if it did not."""
    attributes = dataset.attrs
    if not int(attributes.get("incomplete", 0)):
        is_good = int(attributes.get("is_successful", 1))
        return "" if is_good else "The simulation reported a failure."
    text = str(attributes.get("incomplete_reason", "")).strip() or "It broke off."
    if "incomplete_time" in attributes:
        text += f" It stopped at {float(attributes['incomplete_time']):.4g} s"
        place = np.ravel(attributes.get("incomplete_place", ()))
        if place.size:
            text += f", at {position_text(place)}"
        text += "."
    return text


def _pairs(values: dict[str, str], name: str) -> str:
    if not values:
        return ""
    rows = [[key.replace("_", " "), value] for key, value in values.items()]
    return table_html([name, "value"], rows, is_text=True)


def _cell(value: object) -> str:
    """Return any attribute or cost as text."""
    if isinstance(value, (float, np.floating)):
        return number_text(float(value))
    if isinstance(value, np.ndarray):
        return ", ".join(_cell(item) for item in value.ravel())
    return str(value)


def _um(value: float) -> str:
    return number_text(value * 1e6)


def _length(value: float) -> str:
    return f"{_um(value)} {MICROMETRE}"


def _times(before: float, after: float) -> str:
    """Ratio of `before` to `after`, for a table."""
    if not (np.isfinite(before) and np.isfinite(after)) or after <= 0 or before <= 0:
        return "-"
    return f"{number_text(before / after)} x"
