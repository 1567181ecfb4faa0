import numpy as np
import pytest
from vibrations import receptance, ring_down, with_noise

from diffmill import identification
from diffmill.identification import fit_frequency_response

FREQUENCY = np.linspace(5.0, 60.0, 300)
OMEGA = 2 * np.pi * FREQUENCY
MODES = ((14.0, 0.03, 1.5e6), (27.0, 0.015, 2.3e6))
FACTORS = {"receptance": 1.0, "mobility": 1j * OMEGA, "accelerance": -(OMEGA**2)}


def response(noise=0.0, modes=MODES):
    return with_noise(receptance(FREQUENCY, modes), noise)


@pytest.mark.parametrize("quantity", list(FACTORS))
def test_modes_of_a_clean_response_come_back(quantity):
    fit = fit_frequency_response(
        FREQUENCY, response() * FACTORS[quantity], modes=2, quantity=quantity
    )
    for k, (frequency, zeta, stiffness) in enumerate(MODES):
        np.testing.assert_allclose(fit.frequencies[k], frequency, rtol=1e-6)
        np.testing.assert_allclose(fit.damping_ratios[k], zeta, rtol=1e-5)
        np.testing.assert_allclose(fit.stiffness[k], stiffness, rtol=1e-5)
    assert fit.explained > 1 - 1e-9 and fit.identifiable.all()


@pytest.mark.parametrize(("alike", "relative"), [(0.03, 0.0), (1e-3, 0.02)])
def test_errors_are_as_large_as_the_noise_makes_them(alike, relative):
    """A resonance that scatters more than its neighbours must not seem well known."""
    pulls = []
    for seed in range(12):
        draw = np.random.default_rng(seed)
        clean = response()
        alone = alike * np.sqrt(np.mean(np.abs(clean) ** 2))
        size = np.hypot(alone, relative * np.abs(clean))
        noise = draw.normal(size=300) + 1j * draw.normal(size=300)
        fit = fit_frequency_response(
            FREQUENCY, clean + size * noise, frequencies=[14.5, 26.0]
        )
        for k, (frequency, zeta, stiffness) in enumerate(MODES):
            pulls.append((fit.frequencies[k] - frequency) / fit.frequency_errors[k])
            pulls.append((fit.damping_ratios[k] - zeta) / fit.damping_errors[k])
            pulls.append((fit.stiffness[k] - stiffness) / fit.stiffness_errors[k])
    # 72 numbers of a standard normal distribution.
    assert 0.75 < np.sqrt(np.mean(np.square(pulls))) < 1.3


def test_what_is_missing_is_said():
    with pytest.raises(ValueError):
        fit_frequency_response(FREQUENCY, response())
    with pytest.raises(ValueError, match=r"2.* 3"):
        fit_frequency_response(FREQUENCY, response(), modes=3)


@pytest.mark.parametrize("quantity", ["receptance", "accelerance"])
def test_clear_modes_are_found_below_the_noise_of_an_accelerometer(quantity):
    """Alike in acceleration, it is what stands out most in a displacement."""
    frequency = np.linspace(5.0, 4000.0, 1000)
    omega = 2 * np.pi * frequency
    modes = ((1070.0, 0.035, 2.2e7), (1990.0, 0.02, 4e7), (2650.0, 0.025, 6e7))
    total = -(omega**2) * (1 / 2e8 + receptance(frequency, modes))
    total = with_noise(total, 0.01, seed=1)
    if quantity == "receptance":
        total = -total / omega**2
    fit = fit_frequency_response(frequency, total, modes=3, quantity=quantity)
    assert fit.identifiable.all() and fit.explained > 0.99
    np.testing.assert_allclose(fit.frequencies, [m[0] for m in modes], rtol=2e-3)
    np.testing.assert_allclose(fit.damping_ratios, [m[1] for m in modes], rtol=0.05)
    np.testing.assert_allclose(fit.stiffness, [m[2] for m in modes], rtol=0.05)


def test_what_no_structure_has_is_no_mode():
    broad = response(0.01, modes=((14.0, 0.03, 1.5e6), (30.0, 0.6, 1e6)))
    fit = fit_frequency_response(FREQUENCY, broad, frequencies=[14.0, 30.0])
    assert fit.is_structural.tolist() == [True, False]
    assert fit.identifiable.tolist() == [True, False]
    time = np.arange(0, 1.0, 1e-3)
    signal = np.cos(2 * np.pi * 14 * time) * np.exp(-3 * time) + 2 * np.exp(-9 * time)
    ring = identification.fit_ring_down(time, signal, [3.0, 14.0])
    assert ring.is_structural.tolist() == ring.identifiable.tolist() == [False, True]


def test_a_damped_mode_beside_sharp_ones_is_found_in_a_ring_down():
    time = np.arange(0, 1.5, 1e-3)
    modes = ((11.06, 0.0427, 1.0), (15.4, 0.103, 0.5), (28.1, 0.0115, 0.3))
    signal = ring_down(time, modes)
    signal += 0.01 * np.random.default_rng(0).normal(size=time.size)
    ring = identification.RingDown("ring", time, signal, 3, None, None, ())
    fit = ring.fit()
    np.testing.assert_allclose(fit.frequencies, [m[0] for m in modes], rtol=0.01)
    np.testing.assert_allclose(fit.damping_ratios, [m[1] for m in modes], rtol=0.05)
    assert np.std(signal - fit.fitted) < 0.012


def study(response):
    """Return the study of a response at one point, struck and measured there."""
    lines = np.ones(FREQUENCY.size, bool)
    one = identification.FrequencyResponse(
        "tip", FREQUENCY, response, "receptance", lines, 2, None, None, (), [1, 0, 0]
    )
    return identification.ModeStudy("tip", None, (one,)).run()


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("is_conjugate", [False, True])
def test_a_wrong_sign_of_response_or_phase_is_named_as_that(sign, is_conjugate):
    seen = sign * response(noise=0.01)
    if is_conjugate:
        # Such a response shows no modes at all.
        with pytest.raises(identification.StudyError, match="phase has the wrong sign"):
            study(np.conj(seen))
        return
    (faults,) = study(seen).faults
    assert not faults.is_conjugate
    assert faults.is_reversed == (sign < 0)
