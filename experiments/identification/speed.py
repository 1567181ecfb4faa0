"""How long a fit of a million samples takes."""

import time

import numpy as np

import shared
from diffmill import identification

SAMPLES = 1_000_000


def measure(report):
    teeth = int(SAMPLES / shared.RATE / shared.PERIOD) + 60
    cut = shared.slot([0.05e-3, 0.1e-3], teeth // 2, 0.5e-3)
    clock = 20 * shared.PERIOD + np.arange(SAMPLES) / shared.RATE
    clean = shared.force_at(cut, clock)
    rms = np.sqrt(np.mean(clean**2))
    force = clean + 0.05 * rms * np.random.default_rng(0).normal(size=clean.shape)
    start, used = time.perf_counter(), time.process_time()
    fit = identification.fit_force_coefficients(cut, clock, force)
    seconds, used = time.perf_counter() - start, time.process_time() - used
    report.say(f"{SAMPLES} samples of three forces, {teeth} tooth periods, one compile")
    report.say(f"  largest error {100 * np.abs(fit.raw / shared.K - 1).max():.2g} %")
    # On a busy machine the clock runs on while others compute.
    report.say(f"  processor time of all cores {used:.0f} s")
    report.figure("time of the fit, simulation included", seconds, 60, "s")
