"""Whether the standard errors of the coefficients are what they say."""

import dataclasses

import numpy as np

import shared
from diffmill import identification
from diffmill.cutting import LinearEdgeLaw

FEEDS, TEETH = (0.05e-3, 0.1e-3, 0.15e-3), 60
NOISE, SHIFT, RUNOUT = 0.05, 1.234e-3, 12e-6
SEEDS = 100
# Seeds whose fit is repeated from a cutter without run-out.
BLIND = 5
# The slot begins within the stock: it is steady once the tool has left its start by as
# much as removal lags behind it.
FIRST, LAST = 36, 176


def measure(report):
    report.say("truth: rays 0.25 mm, 480 angles, 20 sub-steps; fit: 0.35 mm, 240, 8")
    report.say(
        f"noise {100 * NOISE:g} % of the force, {SEEDS} seeds, time shift unknown"
    )
    time = np.arange(FIRST * shared.PERIOD, LAST * shared.PERIOD, 1 / shared.RATE)
    for runout in (0.0, RUNOUT):
        refine = ["runout"] if runout else []
        true_cut = shared.finer(
            shared.slot(FEEDS, TEETH, 0.25e-3, runout=runout), 480, 20, 0.15e-3
        )
        clean = shared.force_at(true_cut, time + SHIFT)
        rms = np.sqrt(np.mean(clean**2))
        blind = cut = shared.slot(FEEDS, TEETH, 0.35e-3)
        if runout:
            # Every fit begins at the run-out found without noise: two steps do.
            first = identification.fit_force_coefficients(
                cut, time, clean, refine=refine
            )
            cut = dataclasses.replace(cut, cutter=first.records[0].cut.cutter)
        report.say(
            f"run-out {1e6 * runout:g} um, {'fitted too' if runout else 'known'}"
        )
        off, ratio, apart = [], [], []
        for seed in range(SEEDS):
            draw = np.random.default_rng(seed)
            force = clean + NOISE * rms * draw.normal(size=clean.shape)
            fit = identification.fit_force_coefficients(cut, time, force, refine=refine)
            values, errors = _numbers(fit)
            truth = np.append(shared.K, [SHIFT, *([runout] if runout else [])])
            off.append(values / truth - 1)
            ratio.append((values - truth) / errors)
            if runout and seed < BLIND:
                again = identification.fit_force_coefficients(
                    blind, time, force, refine=refine
                )
                apart.append((_numbers(again)[0] - values) / errors)
        if apart:
            report.figure(
                f"fits of {BLIND} seeds from no run-out and from near it, largest "
                "difference over the standard error",
                np.abs(apart).max(),
                0.1,
                "",
            )
        judge(report, np.stack(off), np.stack(ratio))


def _numbers(fit):
    """Return coefficients, time shift and run-out, and their standard errors."""
    errors = [fit.standard_errors[name] for name in LinearEdgeLaw.NAMES]
    values = np.append(fit.raw, fit.time_shift[0])
    errors.append(fit.time_shift_errors[0])
    if fit.refined:
        values = np.append(values, fit.refined["runout_x"])
        errors.append(fit.refined_errors["runout_x"])
    return values, np.array(errors)


def judge(report, off, ratio):
    """Print what became of every number over the seeds."""
    names = (*LinearEdgeLaw.NAMES, "time shift", "run-out")[: off.shape[1]]
    within = 100 * np.mean(np.abs(ratio) < 2, axis=0)
    for i, name in enumerate(names):
        report.say(
            f"  {name:10}: mean error {100 * off[:, i].mean():6.2f} %, scatter "
            f"{100 * off[:, i].std():5.2f} %, over its standard error: mean "
            f"{ratio[:, i].mean():5.2f}, scatter {ratio[:, i].std():4.2f}, within 2 "
            f"{within[i]:.0f} %"
        )
    report.figure("largest error of a coefficient", 100 * np.abs(off[:, :6]).max(), 2)
    report.at_least("least share within 2 standard errors", within[:6].min(), 90, "%")
    report.figure("largest share within 2 standard errors", within[:6].max(), 99)
