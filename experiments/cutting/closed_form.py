"""The recorded closed-form cases: 48 straight cuts, helix 30 degrees."""

import dataclasses
import json
import math
import os
import pathlib

import numpy as np
from references import marching

import diffmill as dm
from cuts import (
    ALONG,
    DIAMETER,
    NAMES,
    RADIUS,
    SPACING,
    cut,
    mean_force,
    mill,
    reference_force,
    shoulder,
    shoulder_offset,
    straight,
)
from reporting import Report, relative

HELIX = math.radians(30)
# Feeds of the limit, as shares of the recorded ones.
SHARES = (1.0, 0.25)
# So that extremes are not missed between the samples.
ANGLES = 360


def measure(report: Report) -> None:
    """Measure all cases, and the limit of small feeds."""
    report.say()
    root = pathlib.Path(__file__).parents[2]
    folder = os.environ.get("DIFFMILL_REFERENCE_DATA", root / "../shared/data")
    file = pathlib.Path(folder) / "forces" / "closed_form_mean_forces.json"
    if not file.is_file():
        report.say("no data here (set DIFFMILL_REFERENCE_DATA)")
        return
    cases = json.loads(file.read_text())["cases"]
    report.say("Largest error over the cases with an engagement: of the mean force")
    report.say("against trochoids, of the extremes against the same and against the")
    report.say("recorded closed form, relative to the peak [%]; difference of the mean")
    report.say("to the closed form over f / R, at f and f / 4")
    report.say(
        f"  {'cut':8}{'cases':>6}{'mean':>8}{'extremes':>10}{'recorded':>10}"
        f"{'difference over f / R':>32}"
    )
    rows: dict[str, list[np.ndarray]] = {}
    for case in cases:
        rows.setdefault(case["engagement"], []).append(_case(case))
    for name, found in rows.items():
        worst = np.max(found, axis=0)
        cells = "".join(f"{v:10.3f}" for v in worst[3:])
        report.say(
            f"  {name:8}{len(found):6d}{worst[0]:8.2f}{worst[1]:10.2f}"
            f"{worst[2]:10.2f}  {cells}"
        )
    every = np.concatenate(list(rows.values()))
    report.say(f"{len(every)} cases")
    report.figure("mean force, trochoids, largest error", every[:, 0].max(), 1.5)
    report.figure("extremes over a turn, largest error", every[:, 1].max(), 3.0)
    # In proportion to f, this constant would not change at all.
    ratio = every[:, -1] / every[:, 3]
    report.figure(
        "difference over f / R: at f / 4 to that at f, median",
        np.median(ratio),
        1.5,
        "",
    )


def _set_up(case: dict) -> tuple[marching.LinearLaw, float, float, float, bool]:
    values = np.array(case["K_tc_rc_ac_te_re_ae"]) * np.repeat([1e6, 1e3], 3)
    radial, axial, feed = (1e-3 * case[k] for k in ("ae_mm", "ap_mm", "fz_mm"))
    is_up = not case["engagement"].startswith("down")
    return marching.LinearLaw(*map(float, values)), radial, axial, feed, is_up


def _case(case: dict) -> np.ndarray:
    """Return the errors of a case, the last ones at shrinking feeds."""
    law, radial, axial, feed, is_up = _set_up(case)
    solution, first = _cut(case, law, feed)
    circles = reference_force(
        "flat",
        shoulder(axial, radial, is_up),
        feed * ALONG,
        teeth=case["N"],
        helix_angle=HELIX,
        law=law,
        elements=30,
    )
    mean = 100 * relative(mean_force(solution, first), circles.mean(axis=0))
    force = np.asarray(solution.instantaneous_force)[first:].mean(axis=0)
    peak = np.abs(circles).max()
    extremes = [
        100 * max(np.abs(force.max(0) - high).max(), np.abs(force.min(0) - low).max())
        for high, low in (
            (circles.max(0), circles.min(0)),
            (np.array(case["inst_helix30_max"]), np.array(case["inst_helix30_min"])),
        )
    ]
    closed = np.array(case["mean_closed_form_FxFyFz_N"])
    constants = []
    for share in SHARES:
        # The same force in the closed form: less feed, stiffer material.
        scaled = dataclasses.replace(
            law, **{name: getattr(law, name) / share for name in NAMES[:3]}
        )
        found = mean_force(*_cut(case, scaled, share * feed))
        constants.append(relative(found, closed) / (share * feed / RADIUS))
    return np.array([mean, *(e / peak for e in extremes), *constants])


def _cut(case: dict, law: marching.LinearLaw, feed: float) -> tuple[dm.sim.Run, int]:
    """Cut along +x through a block; the instantaneous force is kept."""
    _, radial, axial, _, is_up = _set_up(case)
    lower, upper = np.array([-7e-3, -8.03e-3, -5e-3]), np.array([11e-3, 8.04e-3, 0.0])
    stock = dm.workpiece.box(lower, upper, SPACING)
    if radial >= DIAMETER:
        y = 0.017e-3
    else:
        y = (lower if is_up else upper)[1] + shoulder_offset(radial, is_up)
    path, first = straight([0.0, y, -axial], feed * ALONG)
    coefficients = {name: getattr(law, name) for name in NAMES}
    solution = cut(
        path,
        stock,
        mill("flat", case["N"], HELIX),
        law=dm.cutting.LinearEdgeLaw(**coefficients),
        angles=ANGLES,
        axial_depth=3e-3,
        keeps_instantaneous=True,
    )
    return solution, first
