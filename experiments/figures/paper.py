"""The headline: the example `paper` before and after, and the price of bandwidth."""

import dataclasses
import time

import numpy as np

import diffmill as dm
from shared import Report, example_job

KNOTS = (15e-3, 30e-3, 45e-3, 60e-3)
MIRRORS = ("mirror", "mirror_iterated")


def measure(report: Report) -> None:
    """Correct the example, compare all cases, and trade bandwidth for error."""
    job = example_job("paper")
    settings = dataclasses.replace(job.correction, compare="all")
    job = dataclasses.replace(job, correction=settings)
    start = time.perf_counter()
    correction = dm.correct(job)
    total = time.perf_counter() - start
    rms = {name: found.measures.rms for name, found in correction.methods.items()}
    _table(report, correction, total)
    best_mirror = min(rms[name] for name in MIRRORS)
    report.at_least(
        "uncorrected over corrected", rms["uncorrected"] / rms["corrected"], 20
    )
    report.at_least("best mirror over corrected", best_mirror / rms["corrected"], 5)
    report.figure(
        "corrected over inverse drive", rms["corrected"] / rms["inverse_drive"], 1.0, ""
    )
    report.figure("whole correction", total, 300.0, "s")
    _trade_off(report, job, correction)


def _table(report: Report, correction: dm.Correction, total: float) -> None:
    cuts = int(np.sum(np.asarray(correction.before.is_cutting)))
    rows = correction.before.time.shape[0]
    report.say()
    report.say(f"paper: {rows} tooth periods, {cuts} of them cut; contour error [um]")
    report.say(
        f"  {'case':16}{'rms':>8}{'95 %':>8}{'max':>8}{'a p95':>8}{'a max':>8}"
        f"{'offset':>8}{'runs':>6}{'prod.':>7}{'wall':>8}"
    )
    for name, found in correction.methods.items():
        m, command = found.measures, found.command_statistics
        report.say(
            f"  {name:16}{1e6 * m.rms:8.2f}{1e6 * m.p95:8.2f}{1e6 * m.max:8.1f}"
            f"{command.p95_acceleration:8.2f}{command.max_acceleration:8.2f}"
            f"{1e3 * command.max_offset:8.3f}{found.forward_runs:6d}"
            f"{found.linearisations:7d}{correction.wall_time[name]:8.1f}"
        )
    report.say("  a: acceleration of the command [m/s^2]; offset [mm]; wall time [s]")
    report.say(f"  total {total:.1f} s, compilation included")
    detail = correction.methods["mirror_iterated"].detail
    report.say(
        "  best iterated mirror: "
        + ", ".join(f"{key} {value:g}" for key, value in detail.items())
    )


def _trade_off(report: Report, job: dm.Job, correction: dm.Correction) -> None:
    """Show what a controller of less bandwidth costs."""
    job = job.with_precision()
    settings, before = job.correction, correction.before
    problem = dm.correction.Problem(
        plant=dm.correction.TipPlant(
            job,
            dm.process.ThroughPoses(),
            before.wall_share,
            before.rigid,
        ),
        nominal=np.asarray(before.desired),
        desired=np.asarray(before.desired),
        is_cutting=np.asarray(before.is_cutting, float),
        time_step=float(job.tooth_period),
        max_offset=float(settings.max_offset),
    )
    start = correction.methods["inverse_drive"].command
    report.say()
    report.say("Trade-off: Gauss-Newton from the inverse drive, over the knot spacing")
    report.say(
        f"  {'knots [ms]':>12}{'rms [um]':>10}{'max [um]':>10}{'a p95':>8}{'a max':>8}"
        f"{'systems':>10}{'at bound':>10}"
    )
    for knots in KNOTS:
        method = dm.correction.GaussNewton(
            knot_spacing=knots,
            solver=dm.optimise.LevenbergMarquardt(
                max_steps=settings.max_steps, damping=1e-6, cost_rtol=1e-2
            ),
        )
        found = method(problem, start=start)
        m, command = found.measures, found.command_statistics
        report.say(
            f"  {1e3 * found.detail['knot_spacing']:12.1f}{1e6 * m.rms:10.2f}"
            f"{1e6 * m.max:10.1f}{command.p95_acceleration:8.2f}"
            f"{command.max_acceleration:8.2f}{found.linearisations:10d}{int(found.detail['bound_count']):10d}"
        )
