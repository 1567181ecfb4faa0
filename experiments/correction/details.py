"""All methods on one job: mean, errors by part of the path, surface, price."""

from typing import Any

import diffmill as dm
from diffmill.viz import case_numbers, case_parts
from small_job import small_job


def measure(report: Any, job: dm.Job | None = None) -> None:
    """Print a table of all methods, for the path and for the surface."""
    for name, more in (("path", ""), ("surface", 'objective = "surface"\n')):
        chosen = small_job('compare = "all"\n' + more) if job is None else job
        result = dm.correct(chosen)
        _table(report, name, result.to_dataset())


def _table(report: Any, name: str, data: Any) -> None:
    report.say(f"objective: {name}; errors in um, where the tool cuts")
    report.say(
        f"{'case':16}{'rms':>8}{'95 %':>8}{'max':>8}"
        f"{'mean x':>8}{'y':>8}{'z':>8}"
        f"{'entry':>8}{'exit':>8}{'corner':>8}{'plateau':>8}"
        f"{'wall95':>8}{'floor95':>8}{'m/s^2':>7}{'runs':>6}{'products':>9}{'s':>7}"
    )
    contours = {}
    for case in case_parts(data):
        contour = contours[case.name] = case_numbers(data, case.name).contour
        row = data.sel(case=case.name)
        surface = (float(row[f"surface_{k}_p95"]) for k in ("wall", "floor"))
        errors = (contour.rms, contour.p95, contour.max, *case.mean)
        errors = (*errors, *case.rms.values(), *surface)
        report.say(
            f"{case.name:16}"
            + "".join(f"{1e6 * value:8.1f}" for value in errors)
            + f"{case.max_acceleration:7.2f}{case.forward_runs:6d}"
            + f"{data.attrs[f'{case.name}_products']:9d}{case.seconds:7.1f}"
        )
    before, after = contours["uncorrected"].rms, contours["corrected"].rms
    mirror = min(contours[k].rms for k in ("mirror", "mirror_iterated"))
    if name == "path":
        report.at_least("uncorrected over Gauss-Newton, rms", before / after, 20)
        report.at_least("best mirror over Gauss-Newton, rms", mirror / after, 5)
        report.at_least(
            "inverse drive over Gauss-Newton, rms",
            contours["inverse_drive"].rms / after,
            1,
        )
    report.say()
