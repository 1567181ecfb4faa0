"""Mean force of straight cuts against a quadrature of the chip between trochoids."""

import dataclasses
import functools
import json
import math
import os
import pathlib

import numpy as np
from references import circles

import diffmill as dm
from shared import (
    DIAMETER,
    LAW,
    SPACING,
    Report,
    compiled_process,
    cut_across,
    random_block,
    relative,
    steady_force,
    straight_cut,
)

DIVISORS = (1, 2, 5, 10, 20, 50)
FEEDS = (0.19e-3, 0.1e-3, 0.05e-3, 0.025e-3)
OFFSETS = 10
# Errors below this [%] belong to the quadrature over the angles.
FLOOR = 0.05
SPACINGS = (DIAMETER / 25, DIAMETER / 50, DIAMETER / 100)


def measure(report: Report) -> None:
    """Measure all tables of this group."""
    _straight_cuts(report)
    _spacings(report)
    _closed_form(report)
    _reference_cases(report)


def errors(
    divisor: int,
    feed: float,
    spacing: float = SPACING,
    angles: int | None = None,
) -> np.ndarray:
    """Return the relative errors at random offsets, up- and down-milling, in %."""
    radial_depth = DIAMETER / divisor
    found = []
    for force, depth, is_down in _forces(divisor, feed, spacing, angles):
        cut = straight_cut(feed, radial_depth, is_down)
        wanted = circles.mean_force(LAW, cut, 1.0)
        found.append(100 * relative(force, depth * wanted))
    return np.array(found)


@functools.cache
def _forces(
    divisor: int, feed: float, spacing: float, angles: int | None
) -> list[tuple[np.ndarray, float, bool]]:
    """Return mean force, axial depth and direction of the cuts at random offsets."""
    rng = np.random.default_rng(20 + divisor)
    radial_depth = DIAMETER / divisor
    found = []
    for _ in range(OFFSETS):
        lower, upper, stock = random_block(rng, spacing)
        depth = 1e-3 + rng.uniform(-0.1e-3, 0.1e-3)
        offset = rng.uniform(0, spacing)
        for is_down in (False, True) if divisor > 1 else (False,):
            path = cut_across(
                lower, upper, radial_depth, depth, feed, is_down=is_down, offset=offset
            )
            solution = compiled_process(angles=angles)(path, stock, LAW)
            found.append((steady_force(solution), depth, is_down))
    return found


def _straight_cuts(report: Report) -> None:
    report.say()
    report.say(
        f"Mean-force error of straight cuts, D = 10 mm, d = D/50, {OFFSETS} random "
        "offsets,"
    )
    report.say("up- and down-milling: largest / mean over the offsets [%]")
    header = "".join(f"{f'{1e3 * feed:g} mm':>16}" for feed in FEEDS)
    report.say(f"  {'radial depth':14}{header}   per tooth")
    worst: dict[int, float] = {}
    failed = 0
    for divisor in DIVISORS:
        found = [errors(divisor, feed) for feed in FEEDS]
        report.say(f"  {'D/' + str(divisor):14}{_cells(found)}")
        worst[divisor] = max(float(np.nanmax(e)) for e in found)
        failed += sum(int(np.isnan(e).sum()) for e in found)
    for divisor in DIVISORS:
        what = f"largest error at radial depth D/{divisor}"
        report.figure(what, worst[divisor], 1.5)
    report.figure("runs that failed (overflow of intervals)", failed, 0, "")


def _cells(found: list[np.ndarray]) -> str:
    pairs = [(np.nanmax(e), np.nanmean(e)) for e in found]
    return "".join(f"{largest:9.2f} /{mean:5.2f}" for largest, mean in pairs)


def _spacings(report: Report) -> None:
    report.say()
    report.say("Error over the ray spacing at 0.1 mm per tooth: largest / mean [%]")
    header = "".join(f"{f'd = D/{round(DIAMETER / d)}':>16}" for d in SPACINGS)
    report.say(f"  {'radial depth':14}{header}")
    for divisor in (2, 10, 20, 50):
        found = [errors(divisor, 0.1e-3, d) for d in SPACINGS]
        report.say(f"  {'D/' + str(divisor):14}{_cells(found)}")
        _falls(report, f"defaults: mean error at D/{divisor} falls", found)
    report.say()
    report.say(
        "The same with 96, 192 and 384 angles: the default is 192 at any spacing"
    )
    for divisor in (10, 20, 50):
        found = [
            errors(divisor, 0.1e-3, d, angles=n)
            for d, n in zip(SPACINGS, (96, 192, 384), strict=True)
        ]
        report.say(f"  {'D/' + str(divisor):14}{_cells(found)}")


def _falls(report: Report, what: str, found: list[np.ndarray]) -> None:
    """Require that the error falls, or is too small already for that to be seen."""
    means = [float(np.nanmean(e)) for e in found]
    falls = means[0] > means[1] > means[2]
    report.require(f"{what}, or is below {FLOOR:g} %", falls or max(means) < FLOOR)


def _closed_form(report: Report) -> None:
    report.say()
    report.say("Difference of slots to the closed form h = f sin(phi) [%]")
    found = []
    for feed in FEEDS:
        lower, upper, stock = random_block(np.random.default_rng(3))
        path = cut_across(lower, upper, DIAMETER, 1e-3, feed)
        force = steady_force(compiled_process()(path, stock, LAW))
        closed = circles.thin_chip_mean_force(LAW, feed, 0.0, math.pi, 1e-3)
        wanted = circles.mean_force(LAW, straight_cut(feed, DIAMETER), 1e-3)
        found.append(100 * relative(force, closed))
        report.say(
            f"  f = {1e3 * feed:5.3f} mm: simulation {found[-1]:6.3f}, "
            f"quadrature {100 * relative(wanted, closed):6.3f}"
        )
    report.require("falls with the feed", bool(np.all(np.diff(found) < 0)))


def _reference_cases(report: Report) -> None:
    report.say()
    root = pathlib.Path(__file__).parents[2]
    folder = os.environ.get("DIFFMILL_REFERENCE_DATA", root / "../shared/data")
    file = pathlib.Path(folder) / "forces" / "closed_form_mean_forces.json"
    if not file.is_file():
        report.say("Reference cases: no data here (set DIFFMILL_REFERENCE_DATA)")
        return
    exact, closed = [], []
    for case in json.loads(file.read_text())["cases"]:
        force, wanted = _run_case(case)
        exact.append(100 * relative(force, wanted))
        closed.append(100 * relative(force, case["mean_closed_form_FxFyFz_N"]))
    report.say(f"{len(exact)} reference cases of straight cuts")
    report.figure("largest error against the quadrature", max(exact), 1.5)
    report.say(f"  mean error {np.mean(exact):.2f} %")
    report.say(
        f"  against the closed form: largest {max(closed):.2f} %, above 1.5 % in "
        f"{sum(value > 1.5 for value in closed)} cases"
    )


def _run_case(case: dict) -> tuple[np.ndarray, np.ndarray]:
    names = ("K_tc", "K_rc", "K_ac", "K_te", "K_re", "K_ae")
    scales = (1e6, 1e6, 1e6, 1e3, 1e3, 1e3)
    values = case["K_tc_rc_ac_te_re_ae"]
    law = dm.cutting.LinearEdgeLaw(
        **{n: s * float(v) for n, s, v in zip(names, scales, values, strict=True)}
    )
    radial, axial, feed = (1e-3 * case[k] for k in ("ae_mm", "ap_mm", "fz_mm"))
    is_down = case["engagement"].startswith("down")
    lower, upper, stock = random_block(np.random.default_rng(5))
    path = cut_across(lower, upper, radial, axial, feed, is_down=is_down)
    run = compiled_process(case["N"], 3.1e-3)
    cut = dataclasses.replace(straight_cut(feed, radial, is_down), teeth=case["N"])
    wanted = circles.mean_force(law, cut, axial)
    return steady_force(run(path, stock, law)), wanted
