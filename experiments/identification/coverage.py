"""Whether the standard errors of the coefficients are what they say."""

import numpy as np

import shared
from diffmill import identification

FEEDS, TEETH = (0.05e-3, 0.1e-3, 0.15e-3), 60
NOISE, SHIFT, RUNOUT = 0.05, 1.234e-3, 12e-6
SEEDS, RUNOUT_SEEDS = 100, 8


def measure(report):
    report.say("truth: rays 0.25 mm, 480 angles, 20 sub-steps; fit: 0.35 mm, 192, 8")
    time = np.arange(12 * shared.PERIOD, 176 * shared.PERIOD, 1 / shared.RATE)
    fit_cut = shared.slot(FEEDS, TEETH, 0.35e-3)
    for runout, seeds in ((0.0, SEEDS), (RUNOUT, RUNOUT_SEEDS)):
        refine = ["runout"] if runout else []
        true_cut = shared.finer(
            shared.slot(FEEDS, TEETH, 0.25e-3, runout=runout), 480, 20, 0.15e-3
        )
        clean = shared.force_at(true_cut, time + SHIFT)
        rms = np.sqrt(np.mean(clean**2))
        off, within = [], []
        for seed in range(seeds):
            draw = np.random.default_rng(seed)
            force = clean + NOISE * rms * draw.normal(size=clean.shape)
            fit = identification.fit_force_coefficients(
                fit_cut, time, force, refine=refine
            )
            errors = np.array([fit.standard_errors[n] for n in identification.NAMES])
            off.append(fit.raw / shared.K - 1)
            within.append(np.abs(fit.raw - shared.K) < 2 * errors)
        off, within = 100 * np.stack(off), 100 * np.mean(within, axis=0)
        report.say(f"run-out {1e6 * runout:g} um, time shift unknown, {seeds} seeds")
        for i, name in enumerate(identification.NAMES):
            report.say(
                f"  {name}: mean error {off[:, i].mean():6.2f} %, scatter "
                f"{off[:, i].std():5.2f} %, within 2 standard errors {within[i]:.0f} %"
            )
        report.figure("largest error of a coefficient", float(np.abs(off).max()), 2)
        if seeds == SEEDS:
            report.at_least("least share within 2 standard errors", within.min(), 90)
            report.figure("largest share within 2 standard errors", within.max(), 99)
