import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from diffmill.numerics import lowpass

RATE = 16 * 8000.0 * 2 / 60


def sine(frequency, count=24000):
    time = np.arange(count) / RATE
    return np.stack([np.sin(2 * np.pi * frequency * time)] * 3, axis=1)


@pytest.mark.parametrize("frequency", [20.0, 80.0, 100.0, 150.0, 8000 * 2 / 60])
@pytest.mark.parametrize("order", [2, 4])
def test_gain_and_phase_are_those_of_two_passes(frequency, order):
    """A sine keeps its phase and shrinks by the squared Butterworth gain."""
    signal = sine(frequency)
    filtered = lowpass(signal, RATE, 100.0, order=order)
    warped = np.tan(np.pi * frequency / RATE) / np.tan(np.pi * 100.0 / RATE)
    gain = 1 / (1 + warped ** (2 * order))
    middle = slice(8000, 16000)
    np.testing.assert_allclose(filtered[middle], gain * signal[middle], atol=1e-6)


def test_constant_and_ramp_pass_unchanged():
    time = np.arange(2000) / RATE
    signal = np.stack([np.full_like(time, 7.0), 3.0 * time, -time], axis=1)
    filtered = lowpass(signal, RATE, 100.0)
    np.testing.assert_allclose(filtered[:, 0], 7.0, rtol=1e-9)
    np.testing.assert_allclose(filtered[700:1300], signal[700:1300], atol=1e-7)


@pytest.mark.parametrize("cutoff", [10.0, 100.0, 800.0])
def test_a_record_with_steps_is_filtered_as_by_scipy(cutoff):
    signal = np.random.default_rng(1).normal(size=(6001, 3)).cumsum(axis=0)
    sections = butter(4, cutoff, fs=RATE, output="sos")
    length = int(12 * RATE / cutoff)
    wanted = sosfiltfilt(sections, signal, axis=0, padlen=length)
    largest = np.abs(wanted).max()
    filtered = lowpass(signal, RATE, cutoff)
    np.testing.assert_allclose(filtered, wanted, rtol=0, atol=1e-9 * largest)


def test_short_signal_is_filtered_too():
    signal = np.array([[1.0], [2.0], [4.0], [1.0]])
    assert np.isfinite(lowpass(signal, RATE, 100.0)).all()


@pytest.mark.parametrize("cutoff", [0.0, -1.0, RATE / 2, RATE, np.nan])
def test_impossible_cutoff_is_refused(cutoff):
    with pytest.raises(ValueError, match="`cutoff`"):
        lowpass(sine(20.0, 100), RATE, cutoff)


def test_impossible_order_is_refused():
    with pytest.raises(ValueError, match="`order`"):
        lowpass(sine(20.0, 100), RATE, 100.0, order=0)
