import numpy as np
import pytest

from diffmill import identification

FREQUENCY = np.linspace(5.0, 60.0, 300)
OMEGA = 2 * np.pi * FREQUENCY
MODES = ((14.0, 0.03, 1.5e6), (27.0, 0.015, 2.3e6))
FACTORS = {"receptance": 1.0, "mobility": 1j * OMEGA, "accelerance": -(OMEGA**2)}


def response(noise=0.0, modes=MODES):
    total = 0.0
    for frequency, zeta, stiffness in modes:
        own = 2 * np.pi * frequency
        total = total + own**2 / stiffness / (
            own**2 - OMEGA**2 + 2j * zeta * own * OMEGA
        )
    draw = np.random.default_rng(0)
    size = noise * np.sqrt(np.mean(np.abs(total) ** 2))
    return total + size * (draw.normal(size=300) + 1j * draw.normal(size=300))


@pytest.mark.parametrize("quantity", list(FACTORS))
def test_modes_of_a_clean_response_come_back(quantity):
    fit = identification.fit_frequency_response(
        FREQUENCY, response() * FACTORS[quantity], modes=2, quantity=quantity
    )
    for k, (frequency, zeta, stiffness) in enumerate(MODES):
        np.testing.assert_allclose(fit.frequencies[k], frequency, rtol=1e-6)
        np.testing.assert_allclose(fit.damping_ratios[k], zeta, rtol=1e-5)
        np.testing.assert_allclose(fit.stiffness[k], stiffness, rtol=1e-5)
    assert fit.explained > 1 - 1e-9 and fit.identifiable.all()


def test_errors_are_as_large_as_the_noise_makes_them():
    pulls = []
    for seed in range(12):
        draw = np.random.default_rng(seed)
        clean = response()
        size = 0.03 * np.sqrt(np.mean(np.abs(clean) ** 2))
        noise = draw.normal(size=300) + 1j * draw.normal(size=300)
        fit = identification.fit_frequency_response(
            FREQUENCY, clean + size * noise, frequencies=[14.5, 26.0]
        )
        for k, (frequency, zeta, stiffness) in enumerate(MODES):
            pulls.append((fit.frequencies[k] - frequency) / fit.frequency_errors[k])
            pulls.append((fit.damping_ratios[k] - zeta) / fit.damping_errors[k])
            pulls.append((fit.stiffness[k] - stiffness) / fit.stiffness_errors[k])
    # 72 numbers of a standard normal distribution.
    assert 0.75 < np.sqrt(np.mean(np.square(pulls))) < 1.3


def test_what_is_missing_is_said():
    with pytest.raises(ValueError, match="Exactly one"):
        identification.fit_frequency_response(FREQUENCY, response())
    with pytest.raises(ValueError, match="2 peaks, but 3"):
        identification.fit_frequency_response(FREQUENCY, response(), modes=3)


def test_a_damped_mode_beside_sharp_ones_is_found_in_a_ring_down():
    time = np.arange(0, 1.5, 1e-3)
    signal = np.zeros_like(time)
    modes = ((11.06, 0.0427, 1.0), (15.4, 0.103, 0.5), (28.1, 0.0115, 0.3))
    for frequency, zeta, size in modes:
        own = 2 * np.pi * frequency
        wave = np.cos(own * np.sqrt(1 - zeta**2) * time)
        signal += size * np.exp(-zeta * own * time) * wave
    signal += 0.01 * np.random.default_rng(0).normal(size=time.size)
    guess = identification.ring_down_frequencies(time, signal, 3)
    np.testing.assert_allclose(guess, [m[0] for m in modes], rtol=0.01)
    fit = identification.fit_ring_down(time, signal, guess)
    np.testing.assert_allclose(fit.damping_ratios, [m[1] for m in modes], rtol=0.05)
    assert np.std(signal - fit.fitted) < 0.012
