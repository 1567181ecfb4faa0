"""Joints of a KUKA KR300 R2500 with secondary encoders (Weigand et al., MIT licence).

How well one record foretells the other, below 10 Hz and with all of its frequencies,
and which spring, reversal, delay and friction both give.
"""

import os
import pathlib
import tempfile

import numpy as np

from diffmill import config, identification

GEAR_RATIOS = [256.857, 267.429, 252.333, 221, 239.619, 154.323]
# Left of the same signals by a spring on the torque, the sign of the velocity and an
# acceleration [urad].
PLAIN = (51.0, 57.0, 42.0)
# Of the same data set [N m s/rad].
VISCOUS = (2050.0, 2307.0, 2024.0)


def measure(report):
    folder = os.environ.get("DIFFMILL_REFERENCE_DATA")
    if folder is None:
        report.require("DIFFMILL_REFERENCE_DATA is set", False)
        return
    data = pathlib.Path(folder) / "robots" / "measured" / "kr300_secondary_encoders"
    for lowpass in (10.0, 125.0):
        result = _study(data, lowpass).run()
        report.say(f"below {lowpass:g} Hz, of record B as record A foretells it:")
        for number, fitted in enumerate(result.drives, 1):
            one = fitted.cross_validated[1]
            measured, drive, left = (1e6 * rms for rms in one.rms)
            report.say(
                f"  axis {number}: link less motor {measured:.1f} urad rms, left by "
                f"the drive {drive:.1f}, with what repeats {left:.1f}; of the square "
                f"of what the drive leaves {100 * fitted.repeating_share:.0f} % repeat"
            )
            if lowpass == 10.0:
                report.figure(
                    f"axis {number}, record B", left, PLAIN[number - 1], "urad"
                )
        if lowpass == 10.0:
            _drives(report, result)


def _drives(report, result):
    """Print the drives that both records give."""
    for number, fitted in enumerate(result.drives, 1):
        drive = fitted.drive
        low, high = 1e-6 * np.array(drive.stiffness_interval)
        report.say(
            f"  axis {number}: K {low:.2f} to {high:.2f} MN m/rad, reversal "
            f"{_text(drive.reversal, 1e6)} urad, backlash {_text(drive.backlash, 1e6)} "
            f"urad, presliding {1e6 * drive.presliding:.0f} urad, delay "
            f"{_text(drive.delay, 1e3)} ms, Coulomb {_text(drive.coulomb, 1)} N m, "
            f"viscous {_text(drive.viscous, 1)} N m s/rad"
        )
        off = 100 * abs(drive.viscous.value / VISCOUS[number - 1] - 1)
        report.figure(f"axis {number}, viscous friction less published", off, 20, "%")


def _text(estimate, scale):
    return f"{scale * estimate.value:.3g} +- {scale * estimate.error:.2g}"


def _study(data, lowpass):
    """Return the study of both records."""
    with tempfile.TemporaryDirectory() as folder:
        file = pathlib.Path(folder) / "kr300.toml"
        records = "".join(
            f'[[joint_record]]\nfile = "{data / name}"\n'
            for name in ("record_A.csv", "record_B.csv")
        )
        file.write_text(
            f'kind = "reversal"\n[reversal]\ngear_ratios = {GEAR_RATIOS}\n'
            f'lowpass = "{lowpass} Hz"\n{records}'
        )
        study = config.load_identification(file, allow_outside=True)
    assert isinstance(study, identification.ReversalStudy)
    return study
