"""Whether standard errors of force coefficients hold what records have beside noise.

The columns of the cut are those of an independent program where only the statistics are
looked at, and those of the simulation where its own error counts.
"""

import functools
import math

import numpy as np
import pytest
from references.trochoid import TrochoidCut
from scipy.signal import lfilter
from slot_force import DEPTH, HELIX, PERIOD, SPEED, K, R

from diffmill import cutter as ct, cutting, identification, workpiece as wp

NAMES = cutting.LinearEdgeLaw.NAMES
FEED, WIDTH, RATE = 0.12e-3, 2e-3, 10e3


def true_cut(feed=FEED, coefficients=K, side="down", **options):
    return TrochoidCut(
        coefficients, feed, DEPTH, SPEED, R, 2, HELIX, side, WIDTH, **options
    )


@functools.cache
def exact_source(periods):
    """Return a cut whose columns are those of the independent program."""
    spacing = PERIOD / 240
    grid = spacing * (0.5 + np.arange(periods * 240))
    unit = np.stack([true_cut(coefficients=k).force(grid) for k in np.eye(6)], axis=2)
    rows = np.column_stack([FEED * np.arange(periods + 1), *np.zeros((2, periods + 1))])
    stock = wp.box([0, 0, -1e-3], [1e-3, 1e-3, 0], 0.5e-3, interval_counts=(1, 1, 1))
    mill = ct.flat_end_mill(2 * R, 2, helix_angle=HELIX)
    nothing = np.zeros((len(grid), 3))
    columns = identification.EngagementColumns(
        grid[0], spacing, unit, nothing, np.zeros_like(unit)
    )
    time = np.arange(3 * PERIOD, (periods - 3) * PERIOD, 1.0003 / RATE)
    clean = true_cut().force(time)
    return (
        identification.RecordRegistration(
            identification.Cut(rows, stock, mill, SPEED),
            columns,
            time,
            clean,
            0.0,
            identification.propose_axes(clean, np.ones((len(clean), 3, 6)), RATE),
            None,
            SPEED,
            (),
        ),
        time,
        clean,
    )


def errors(fit):
    return np.array([fit.standard_errors[name] for name in NAMES])


def fitted(force, periods=46, **options):
    source, time, _ = exact_source(periods)
    return identification.fit_force_coefficients(
        source, time, force, time_shift=0.0, **options
    )


@pytest.mark.parametrize("colour", [0.0, 0.95])
def test_errors_are_those_of_noise_of_any_colour(colour):
    _, _, clean = exact_source(46)
    off = []
    for seed in range(40):
        white = np.random.default_rng(seed).normal(size=(len(clean) + 500, 3))
        noise = lfilter([math.sqrt(1 - colour**2)], [1, -colour], white, axis=0)[500:]
        fit = fitted(clean + 5 * noise, has_offset=False, has_drift=False)
        off.append((fit.raw - K) / errors(fit))
    scatter = np.sqrt(np.mean(np.square(off), axis=0))
    # 40 draws tell a standard deviation to 11 %; coloured noise is seen but few times.
    assert (scatter > 0.6).all() and (scatter < 1.5).all()


def test_offset_and_drift_are_fitted_beside_the_coefficients():
    _, time, clean = exact_source(46)
    offset, drift = np.array([12.0, -7.0, 5.0]), np.array([-40.0, 60.0, 25.0])
    since = time - (time[0] + time[-1]) / 2
    noise = np.random.default_rng(0).normal(size=clean.shape)
    seen = clean + offset + drift * since[:, None] + noise
    fit = fitted(seen)
    assert (np.abs(fit.raw - K) < 4 * errors(fit)).all()
    np.testing.assert_allclose(fit.offset[0], offset, atol=0.5)
    np.testing.assert_allclose(fit.drift[0], drift, atol=4)
    assert "were fitted beside the coefficients" in " ".join(fit.notes)
    # The record is returned without them.
    np.testing.assert_allclose(fit.records[0].force, clean + noise, atol=1)
    known = fitted(seen, has_offset=False, has_drift=False)
    assert (np.abs(known.raw - K) > 4 * errors(known)).any()
    assert not known.offset.any() and not known.drift.any()
    # Known at its start, the record drifts from there on.
    seen = clean + drift * (time - time[0])[:, None] + noise
    from_start = fitted(seen, has_offset=False)
    np.testing.assert_allclose(from_start.drift[0], drift, atol=4)


def test_what_repeats_with_the_teeth_does_not_average_out():
    """A longer record knows no better what the model cannot represent."""
    stated = {}
    for periods in (26, 86):
        _, time, clean = exact_source(periods)
        phase = 2 * math.pi * time / PERIOD
        wave = np.stack([np.sin(6 * phase), np.cos(8 * phase), np.sin(10 * phase)], 1)
        noise = np.random.default_rng(0).normal(size=clean.shape)
        fit = fitted(clean + 8 * wave + noise, periods)
        alone = fitted(clean + noise, periods)
        stated[periods] = errors(fit), errors(alone)
        assert (np.abs(fit.raw - K) < 3 * errors(fit)).all()
    for i, ratio in ((0, 1.0), (1, 2.0)):
        fall = stated[26][i] / stated[86][i]
        np.testing.assert_allclose(fall, ratio, rtol=0.4)


@pytest.mark.slow
@pytest.mark.parametrize("side", ["slot", "down", "up"])
def test_intervals_hold_the_truth_of_exact_trochoids(side):
    """With the simulation's own error, an unknown start, and noise that is small."""
    feeds, width = (0.08e-3, 0.16e-3), None if side == "slot" else WIDTH
    mill = ct.flat_end_mill(2 * R, 2, helix_angle=HELIX)
    time, sources = np.arange(0, 30.5 * PERIOD, 1 / 20e3), []
    for feed in feeds:
        sizes = identification.StraightCut(mill, SPEED, feed, DEPTH, width, side)
        clean = true_cut(feed, side=side).force(time)
        sources.append(
            identification.RecordRegistration.on_straight_cut(
                sizes, time, clean, refines_speed=False, largest_feed=max(feeds)
            )
        )
    off = []
    for seed in range(10):
        draw = np.random.default_rng(seed)
        seen = [
            true_cut(feed, side=side).force(s.time + draw.uniform(-1, 1) * 1e-3)
            for feed, s in zip(feeds, sources, strict=True)
        ]
        seen = [f + draw.normal(size=f.shape) + 10 * draw.normal(size=3) for f in seen]
        fit = identification.fit_force_coefficients(
            sources, [s.time for s in sources], seen, has_drift=False
        )
        off.append((fit.raw - K) / errors(fit))
    # Where an edge is always in the cut, an offset hides K_ae: its interval is wide.
    assert (np.abs(off) < 1.96).mean() >= 0.85
    assert 1 / 3 < np.sqrt(np.mean(np.square(off))) < 1.3
