"""A real slot measurement: lines over the feed, and what they say of the tooth passing.

The record's Fx is F_y of this package and its Fy is F_x. The diameter and the helix of
the tool are not in the data: the amplitude is printed for several of them.
"""

import json
import os
import pathlib

import numpy as np

import shared
from diffmill import identification


def measure(report):
    folder = os.environ.get("DIFFMILL_REFERENCE_DATA")
    if folder is None:
        report.require("DIFFMILL_REFERENCE_DATA is set", False)
        return
    path = pathlib.Path(folder) / "forces" / "measured_slot_means.json"
    data = json.loads(path.read_text())
    feeds = np.array(data["feed_per_tooth_mm"]) * 1e-3
    mean, found = data["mean_N"], data["amplitude_200Hz_N"]
    force = np.column_stack([mean["Fy"], mean["Fx"], mean["Fz"]])
    fit = identification.fit_mean_forces(feeds, force, teeth=2, axial_depth=3e-3)
    worst = 0.0
    for name, value in fit.coefficients.items():
        wanted = data["coefficients"][name] * (1e6 if name.endswith("c") else 1e3)
        worst = max(worst, 100 * abs(value / wanted - 1))
        report.say(f"  {name} {value:.5g} +- {fit.standard_errors[name]:.2g}")
    report.figure(
        "coefficients of the published line fit, largest difference", worst, 0.1
    )
    K = np.array(list(fit.coefficients.values()))
    wanted = np.column_stack([found["Fy"], found["Fx"]])
    for helix in (0.0, 30.0, 45.0):
        off = []
        for feed, measured in zip(feeds, wanted, strict=True):
            cut = shared.slot([feed], 40, 0.4e-3, depth=3e-3, helix=helix)
            columns = identification.EngagementColumns.of_cut(cut)
            samples = round(shared.PERIOD / columns.spacing)
            waves = (columns.columns @ K)[20 * samples : 36 * samples, :2]
            # Sixteen tooth periods: the tooth passing is line 16 of the spectrum.
            amplitude = 2 * np.abs(np.fft.rfft(waves, axis=0)[16]) / len(waves)
            off.append(100 * (amplitude / measured - 1))
        off = np.stack(off)
        report.say(f"  helix {helix:g} deg, error of the 200 Hz amplitude [%]:")
        report.say(f"    F_x {np.round(off[:, 0], 1)}, F_y {np.round(off[:, 1], 1)}")
        if helix == 30.0:
            report.figure("200 Hz amplitude, helix 30 deg", np.abs(off).max(), 20)
