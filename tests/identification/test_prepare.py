"""Tare, drift, filter, rate, cuts and the spindle's angle, against closed forms."""

import numpy as np
import pytest

from diffmill.identification import (
    CutSpan,
    Record,
    find_saturated,
    refine_spindle_speed,
)

RATE, SPEED = 5e3, 2 * np.pi * 50.0
AMPLITUDE = np.array([100.0, 60.0, 20.0])
LEVEL = np.array([5.0, -3.0, 40.0])


def record_of(time, force, gaps=(), **channels):
    is_after_gap = np.zeros(time.size, dtype=bool)
    is_after_gap[list(gaps)] = True
    return Record(
        time, force, RATE, np.zeros(time.size, bool), is_after_gap, **channels
    )


def turn_force(angle):
    """Return a force of several harmonics, no two teeth alike."""
    phases = np.array([0.0, 1.0, 2.0])
    return AMPLITUDE[None] * (
        np.cos(2 * angle[:, None] + phases[None])
        + 0.5 * np.cos(4 * angle[:, None] - phases[None])
        + 0.3 * np.cos(angle[:, None] + 2 * phases[None])
    )


def cut_record(spans, noise=0.5, duration=4.0):
    time = np.arange(round(duration * RATE)) / RATE
    cuts = np.any([(time > start) & (time < stop) for start, stop in spans], axis=0)
    force = turn_force(SPEED * time) * cuts[:, None] + LEVEL[None]
    force += noise * np.random.default_rng(0).normal(size=force.shape)
    return record_of(time, force)


def test_offset_and_drift_come_off_exactly():
    time = np.arange(2000) / RATE
    force = turn_force(SPEED * time) * ((time > 0.1) & (time < 0.3))[:, None]
    slope = np.array([7.0, 0.0, -30.0])
    record = record_of(time, force + LEVEL[None] + slope[None] * time[:, None])
    tare = record.tare(slice(0.0, 0.09), slice(0.31, 0.4))
    np.testing.assert_allclose(record.without(tare).force, force, atol=1e-10)
    level = record_of(time, force + LEVEL[None])
    flat = level.without(level.tare(slice(0.0, 0.09)))
    np.testing.assert_allclose(flat.force, force, atol=1e-10)
    np.testing.assert_allclose(tare.offset, LEVEL + slope * tare.instant)
    np.testing.assert_allclose(tare.drift, slope, atol=1e-9)
    np.testing.assert_allclose(tare.noise, 0, atol=1e-9)
    with pytest.raises(ValueError, match="5 s to 6 s"):
        record.tare(slice(5.0, 6.0))
    with pytest.raises(ValueError, match="`before` and `after`"):
        record.tare(slice(0.0, 0.1), slice(0.0, 0.1))


def test_the_noise_of_a_tare_is_that_about_its_drift():
    time = np.arange(2000) / RATE
    noise = np.array([0.5, 2.0, 0.0])
    force = LEVEL[None] + np.array([300.0, -40.0, 5.0])[None] * time[:, None]
    force += noise[None] * np.random.default_rng(0).normal(size=force.shape)
    # Gross errors are no noise.
    force[[50, 300]] += 1e3
    tare = record_of(time, force).tare(slice(0.0, 0.2))
    np.testing.assert_allclose(tare.noise, noise, rtol=0.06, atol=1e-9)


@pytest.mark.parametrize("tooth_frequency", [None, 100.0])
def test_several_cuts_are_found(tooth_frequency):
    spans = [(0.5, 1.2), (1.6, 1.9), (2.5, 3.7)]
    cuts = CutSpan.find(cut_record(spans), tooth_frequency=tooth_frequency)
    np.testing.assert_allclose(np.array(cuts), np.array(spans), atol=0.01)


@pytest.mark.parametrize("tooth_frequency", [None, 100.0])
@pytest.mark.parametrize("span", [(0.5, 19.5), (8.0, 8.6)])
def test_short_idle_sections_and_short_cuts_are_found(tooth_frequency, span):
    record = cut_record([span], duration=20.0)
    record.force[[20_000, 41_000, 70_000]] += 5e3
    (cut,) = CutSpan.find(record, tooth_frequency=tooth_frequency)
    np.testing.assert_allclose(cut, span, atol=0.01)


@pytest.mark.parametrize("spans", [[(30.0, 31.0)], [(-1.0, 21.0)]])
def test_noise_or_a_cut_alone_with_spikes_is_whole(spans):
    record = cut_record(spans, noise=20.0, duration=20.0)
    record.force[[20_000, 41_000, 70_000]] += 5e3
    (cut,) = CutSpan.find(record, tooth_frequency=100.0)
    np.testing.assert_allclose(cut, record.time[[0, -1]])


def test_an_idling_spindle_is_no_cut_at_the_tooth_frequency():
    record = cut_record([(1.0, 2.0)])
    hum = 30.0 * np.sin(2 * np.pi * 370.0 * record.time)
    loud = record_of(record.time, record.force + hum[:, None])
    (cut,) = CutSpan.find(loud, tooth_frequency=100.0)
    np.testing.assert_allclose(cut, (1.0, 2.0), atol=0.01)


def test_a_gap_ends_a_cut_and_a_record_of_one_cut_is_whole():
    time = np.arange(1000) / RATE
    time[500:] += 1.0
    record = record_of(time, turn_force(SPEED * time), gaps=[500])
    cuts = CutSpan.find(record)
    np.testing.assert_allclose(
        np.array(cuts), [(time[0], time[499]), (time[500], time[-1])]
    )
    # Lost samples are no end of it.
    time[500:] -= 0.99
    (cut,) = CutSpan.find(record_of(time, turn_force(SPEED * time), gaps=[500]))
    np.testing.assert_allclose(cut, (time[0], time[-1]))


def test_the_tacho_gives_the_angle():
    time = np.arange(5000) / RATE
    # The spindle speeds up; pulses of a tenth of a turn with a slope, and noise.
    angle = SPEED * time + 20.0 * time**2
    turned = np.mod(angle + 0.3, 2 * np.pi)
    noise = 0.02 * np.random.default_rng(1).normal(size=time.size)
    pulse = np.clip(4.0 * (0.6 - np.abs(turned - 0.6)), 0.0, 1.0) + noise
    record = record_of(time, np.zeros((5000, 3)), tacho=pulse)
    found = record.angle_from_tacho()
    error = found - angle
    # A sample is 0.06 rad.
    assert np.ptp(error[200:-200]) < 0.03
    missing = np.where((time > 0.5) & (time < 0.51), 0.0, pulse)
    again = record_of(time, record.force, tacho=missing).angle_from_tacho()
    np.testing.assert_allclose(again[-1], found[-1], atol=0.05)
    # A cell without a number lies between its neighbours.
    empty = np.where(np.arange(5000) % 500 == 0, np.nan, pulse)
    again = record_of(time, record.force, tacho=empty).angle_from_tacho()
    np.testing.assert_allclose(again, found, atol=0.1)
    with pytest.raises(ValueError):
        record_of(time, record.force).angle_from_tacho()
    with pytest.raises(ValueError):
        record_of(time, record.force, tacho=0.0 * time).angle_from_tacho()


def test_a_force_that_was_not_measured_stays_so():
    time = np.arange(1500) / RATE
    force = turn_force(SPEED * (time - 0.00313))
    force[:, 0] = 0.0
    record = record_of(time, force, is_measured=(False, True, True))
    other = record.without(record.tare(slice(0.0, 0.1)))
    assert other.is_measured == record.is_measured and not other.force[:, 0].any()
    with pytest.raises(ValueError, match="`force`"):
        record_of(time, force, is_measured=(True, True, False))
    with pytest.raises(ValueError, match="`is_measured`"):
        record_of(time, 0.0 * force, is_measured=(False,) * 3)


@pytest.mark.parametrize("off", [-0.008, 0.003])
def test_the_true_speed_is_found(off):
    time = np.arange(10000) / RATE
    force = turn_force(SPEED * time) + 5 * np.random.default_rng(4).normal(
        size=(10000, 3)
    )
    speed = refine_spindle_speed(time, force, SPEED * (1 + off), flute_count=2)
    assert speed == pytest.approx(SPEED, rel=1e-5)


def test_a_smooth_peak_is_not_saturated():
    time = np.arange(2000) / RATE
    # A converter of few bits repeats the values of slow maxima.
    coarse = np.round(20 * np.sin(2 * np.pi * 10 * time))
    clipped = np.clip(100 * np.sin(2 * np.pi * 50 * time), -50.0, 80.0)
    rest = np.zeros_like(time)
    found = find_saturated(np.stack([coarse, clipped, rest], axis=1))
    assert not found[:, 0].any() and not found[:, 2].any()
    np.testing.assert_array_equal(found[:, 1], (clipped == -50.0) | (clipped == 80.0))


def test_noise_and_spikes_do_not_hide_a_clipped_channel():
    time, draw = np.arange(4000) / RATE, np.random.default_rng(0)
    waves = AMPLITUDE[None] * np.sin(
        2 * np.pi * 50 * time[:, None] + np.arange(3)[None]
    )
    clipped = np.clip(waves, -40.0, 90.0)
    is_end = clipped != waves
    clipped = clipped + 0.02 * draw.normal(size=waves.shape)
    spikes = draw.choice(4000, 8, replace=False)
    clipped[spikes] = 3000.0
    found = find_saturated(clipped)
    assert np.mean(found[is_end]) > 0.97 and not found[:, 2].any()
    is_spike = np.isin(np.arange(4000), spikes)
    assert not found[~is_end & ~is_spike[:, None]].any()


def test_a_tool_out_of_the_cut_is_not_saturated():
    """Without noise all forces rest at once, at zero or at their offsets."""
    time = np.arange(4000) / RATE
    cuts = ((time > 0.2) & (time < 0.6))[:, None]
    wave = np.where(cuts, AMPLITUDE[None] * (1.2 + turn_force(SPEED * time) / 200), 0.0)
    assert not find_saturated(wave).any()
    assert not find_saturated(np.round(wave + LEVEL[None], 1)).any()


def test_gross_errors_do_not_move_the_tare():
    time, draw = np.arange(1000) / RATE, np.random.default_rng(0)
    force = LEVEL[None] + draw.normal(size=(1000, 3))
    wanted = force - force.mean(axis=0)[None]
    bad = force.copy()
    bad[[20, 400, 900]] = 1e4
    record = record_of(time, bad)
    found = record.without(record.tare(slice(0.0, 1.0))).force
    np.testing.assert_allclose(
        np.delete(found, [20, 400, 900], 0)[0], wanted[0], atol=0.02
    )


def test_what_is_no_record_is_refused():
    time = np.arange(10) / RATE
    with pytest.raises(ValueError, match="`time`"):
        record_of(time[::-1], np.zeros((10, 3)))
    with pytest.raises(ValueError, match="`force`"):
        record_of(time, np.full((10, 3), np.nan))
    with pytest.raises(ValueError, match="2 samples"):
        record_of(time[:1], np.zeros((1, 3)))
