"""Whether intervals of 95 % hold the coefficients of an independent program.

Records are those of teeth on exact trochoids in a stock with a free side, in NumPy
(`tests/references/trochoid.py`): two feeds, an unknown start, and what measurements
have: noise, white or coloured, offsets, drifts, run-out. A case is held if intervals
of 1.96 standard errors hold between 85 and 99 % of the draws of each coefficient, or
more where the standard error is no more than three times the actual error; or if the
fit names why its coefficients are not to be used.
"""

import dataclasses
from typing import Any

import numpy as np
import scipy.signal
from references.trochoid import TrochoidCut

from diffmill import cutter as ct, cutting, identification

NAMES = cutting.LinearEdgeLaw.NAMES
K = np.array([850e6, 280e6, -150e6, 14e3, 19e3, -2e3])
RADIUS, TEETH, HELIX, DEPTH = 5e-3, 2, np.radians(30), 2e-3
SPEED = 6000 * 2 * np.pi / 60
PERIOD = 2 * np.pi / SPEED / TEETH
FEEDS, RATE, DRAWS = (0.08e-3, 0.16e-3), 20e3, 30
TIME = np.arange(0.0, 40.5 * PERIOD, 1 / RATE)
SIDES = {"slot": None, "up": 2e-3, "down": 2e-3}
# Largest stated standard error over the root mean square of the actual one.
WIDEST = 3.0


@dataclasses.dataclass(frozen=True)
class Disturbance:
    """What a record has beside the force of its cut.

    Attributes:
        noise: Standard deviation [N].
        colour: Correlation of the noise from sample to sample.
        offset: Standard deviation of the offsets of channels [N].
        drift: Of their slopes [N/s].
        runout: Of the cutter [m].
    """

    noise: float = 5.0
    colour: float = 0.0
    offset: float = 0.0
    drift: float = 0.0
    runout: float = 0.0

    def record(self, cut: TrochoidCut, time, draw: np.random.Generator) -> np.ndarray:
        """Return the force of a cut [N], shape (row, 3), as it would be measured."""
        force = cut.force(time)
        settled = draw.normal(size=(2000 + len(force), 3))
        share = np.sqrt(1 - self.colour**2)
        filtered = scipy.signal.lfilter([share], [1, -self.colour], settled, axis=0)
        noise = np.asarray(filtered)
        line = (time - time[0])[:, None] * draw.normal(size=3)
        offset = self.offset * draw.normal(size=3)
        return force + self.noise * noise[2000:] + offset + self.drift * line


KNOWN = {"has_offset": False, "has_drift": False}
# Name, disturbance, what the fit knows or fits beside, and whether it must refuse.
CASES: list[tuple[str, Disturbance, dict[str, Any], bool]] = [
    ("noise 5 N, tared", Disturbance(), KNOWN, False),
    ("noise 1 N, tared", Disturbance(noise=1.0), KNOWN, False),
    ("noise 5 N", Disturbance(), {}, False),
    ("noise 1 N", Disturbance(noise=1.0), {}, False),
    ("coloured noise 5 N", Disturbance(colour=0.95), {}, False),
    ("offset 10 N", Disturbance(offset=10.0), {}, False),
    ("drift 60 N/s", Disturbance(drift=60.0), {}, False),
    ("run-out 6 um", Disturbance(runout=6e-6), {}, True),
    ("run-out 6 um, fitted", Disturbance(runout=6e-6), {"refine": ["runout"]}, False),
]


def measure(report):
    report.say(f"{DRAWS} draws; bias, scatter and mean stated error in % of each")
    report.say("coefficient; stated over the root mean square of the actual error")
    for side, radial_depth in SIDES.items():
        sources = [_source(feed, side, radial_depth) for feed in FEEDS]
        for name, disturbance, options, refuses in CASES:
            report.say(f"{side}, {name}")
            _judge(report, side, sources, disturbance, options, refuses)


def _source(feed, side, radial_depth, runout=0.0):
    """Return a cut that is simulated once for all draws."""
    mill = ct.flat_end_mill(2 * RADIUS, TEETH, helix_angle=HELIX, runout=runout)
    sizes = identification.StraightCut(mill, SPEED, feed, DEPTH, radial_depth, side)
    registration = identification.RecordRegistration.on_straight_cut(
        sizes,
        TIME,
        _true_cut(feed, side, 0.0).force(TIME),
        refines_speed=False,
        largest_feed=max(FEEDS),
    )
    return registration


def _true_cut(feed, side, runout):
    """Return the cut of the independent program."""
    width = np.nan if SIDES[side] is None else SIDES[side]
    return TrochoidCut(K, feed, DEPTH, SPEED, RADIUS, TEETH, HELIX, side, width, runout)


def _judge(report, side, sources, disturbance, options, refuses):
    """Fit all draws of a case and say what became of every coefficient."""
    found, errors, told = [], [], []
    for seed in range(DRAWS):
        draw = np.random.default_rng(seed)
        shifts = draw.uniform(-0.3, 0.3, len(FEEDS)) * PERIOD
        forces = [
            disturbance.record(
                _true_cut(feed, side, disturbance.runout), source.time + shift, draw
            )
            for feed, source, shift in zip(FEEDS, sources, shifts, strict=True)
        ]
        fit = identification.fit_force_coefficients(
            sources, [s.time for s in sources], forces, **options
        )
        found.append(fit.raw)
        errors.append([fit.standard_errors[name] for name in NAMES])
        told.append({one.code for one in fit.diagnoses if one.is_grave})
    found, errors = np.array(found), np.array(errors)
    off = found - K
    within = 100 * np.mean(np.abs(off) <= 1.96 * errors, axis=0)
    actual = np.sqrt(np.mean(off**2, axis=0))
    ratio = np.sqrt(np.mean(errors**2, axis=0)) / actual
    size = np.abs(K)
    for i, name in enumerate(NAMES):
        report.say(
            f"  {name}: bias {100 * off[:, i].mean() / size[i]:6.2f}, scatter "
            f"{100 * off[:, i].std() / size[i]:5.2f}, stated "
            f"{100 * errors[:, i].mean() / size[i]:5.2f}, held in {within[i]:3.0f} %, "
            f"stated over actual {ratio[i]:4.2f}"
        )
    if refuses:
        share = 100 * np.mean([bool(codes) for codes in told])
        report.at_least("draws that are refused, the cause named", share, 99, "%")
        return
    report.at_least("least share held", within.min(), 85, "%")
    report.figure("largest stated over actual error", ratio.max(), WIDEST, "")
