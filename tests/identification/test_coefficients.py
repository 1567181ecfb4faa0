import functools
import math

import numpy as np
import pytest

from diffmill import cutter as ct, identification, workpiece as wp

NAMES = identification.NAMES
K = np.array([958.86e6, 250.863e6, 146.361e6, 15.758e3, 19.434e3, 18.207e3])
SPEED = 6000 * 2 * math.pi / 60
PERIOD = math.pi / SPEED
R, DEPTH, HELIX = 5e-3, 2e-3, math.radians(30)
STEPS = 45
FEEDS = (0.08e-3, 0.16e-3)


def slot(feed):
    """A slot that begins within the stock: what comes first is not looked at."""
    x = feed * np.arange(STEPS)
    rows = np.column_stack([x, np.full(STEPS, 6e-3), np.full(STEPS, -DEPTH)])
    return identification.Cut(
        rows,
        wp.box([-6e-3, 0, -3e-3], [14e-3, 12e-3, 0], 0.4e-3, interval_counts=(4, 4, 1)),
        ct.flat_end_mill(2 * R, 2, helix_angle=HELIX),
        SPEED,
    )


@functools.cache
def cuts():
    return tuple(slot(feed) for feed in FEEDS)


def force(time, feed, runout=0.0):
    """The force of a slot in NumPy: fine discs, chips between two circles."""
    z = (np.arange(100) + 0.5) * DEPTH / 100
    total = np.zeros((len(time), 3))
    for tooth in range(2):
        phi = SPEED * time[:, None] + math.pi * tooth - z[None] * math.tan(HELIX) / R
        # The tooth before stands out by the opposite of what this one does.
        more = 2 * runout * (1 - 2 * tooth)
        h = R + more + feed * np.sin(phi) - np.sqrt(R**2 - (feed * np.cos(phi)) ** 2)
        if runout:
            # Near its entry a tooth that stands out meets its own last path first.
            own = R + 2 * feed * np.sin(phi)
            h = np.minimum(h, own - np.sqrt(R**2 - (2 * feed * np.cos(phi)) ** 2))
        touch = h > 0
        h = np.maximum(h, 0)
        F_t, F_r, F_a = (K[i] * h + K[3 + i] * touch for i in range(3))
        share = DEPTH / 100
        total[:, 0] += share * np.sum(-F_t * np.cos(phi) - F_r * np.sin(phi), axis=1)
        total[:, 1] += share * np.sum(F_t * np.sin(phi) - F_r * np.cos(phi), axis=1)
        total[:, 2] += share * np.sum(F_a, axis=1)
    return total


def record(feed, seed=0, noise=0.05, shift=0.0, runout=0.0):
    # From the eleventh tooth on the slot is steady.
    time = np.arange(11 * PERIOD, (STEPS - 3) * PERIOD, 1e-4)
    clean = force(time + shift, feed, runout)
    rms = np.sqrt(np.mean(clean**2))
    draw = np.random.default_rng(seed)
    return time, clean + noise * rms * draw.normal(size=clean.shape)


def found(fit):
    return np.array([fit.coefficients[name] for name in NAMES])


def errors(fit):
    return np.array([fit.standard_errors[name] for name in NAMES])


def both(**how):
    pairs = [record(feed, i, **how) for i, feed in enumerate(FEEDS)]
    return list(cuts()), [t for t, _ in pairs], [f for _, f in pairs]


def test_records_of_an_independent_program_give_the_coefficients():
    cut, time, seen = both(noise=0.0)
    fit = identification.fit_force_coefficients(cut, time, seen, time_shift=0.0)
    np.testing.assert_allclose(found(fit), K, rtol=1.5e-2)
    assert fit.explained > 0.9995 and all(fit.identifiable.values())
    assert fit.notes == () and fit.time_shift == (0.0, 0.0)
    assert max(fit.left_out_rms) < 0.03


def test_noise_a_time_shift_and_turned_axes():
    shift = 1.7e-3
    cut, time, seen = both(shift=shift)
    # The dynamometer's y is the work's -x, its x the work's y.
    turned = [np.column_stack([f[:, 1], -f[:, 0], f[:, 2]]) for f in seen]
    fit = identification.fit_force_coefficients(
        cut, time, turned, axes=("-y", "x", "z")
    )
    assert fit.axes == ("-y", "x", "z")
    np.testing.assert_allclose(fit.time_shift, shift, atol=1e-5)
    assert (np.abs(found(fit) - K) < 4 * errors(fit) + 0.01 * K).all()
    assert fit.residual_rms / fit.force_rms == pytest.approx(0.05, rel=0.1)
    assert (errors(fit) < 0.05 * K).all()


def test_gross_errors_change_little_under_a_robust_loss():
    cut, time, seen = both()
    clean = identification.fit_force_coefficients(cut, time, seen, time_shift=0.0)
    draw = np.random.default_rng(5)
    for f in seen:
        f[draw.choice(len(f), len(f) // 20, replace=False)] = 2000.0
    fits = {
        loss: identification.fit_force_coefficients(
            cut, time, seen, time_shift=0.0, loss=loss
        )
        for loss in ("squares", "tukey")
    }
    off = {n: np.abs(fit.raw / clean.raw - 1).max() for n, fit in fits.items()}
    assert off["tukey"] < 0.05 < off["squares"]


def test_what_is_not_measured_is_not_identifiable():
    cut, time, seen = both()
    for f in seen:
        f[:, 2] = np.nan
    fit = identification.fit_force_coefficients(cut, time, seen, time_shift=0.0)
    lost = {name for name in NAMES if not fit.identifiable[name]}
    assert lost == {"K_ac", "K_ae"}
    assert math.isnan(fit.coefficients["K_ac"])
    assert math.isinf(fit.standard_errors["K_ae"])
    assert "axial force" in " ".join(fit.notes)
    assert fit.law.K_ac == 0


def test_the_spectrum_of_the_residual_shows_what_the_model_has_not():
    cut, time, seen = both(noise=0.01)
    seen[0][:, 1] += 8 * np.sin(2 * math.pi * 730 * time[0])
    fit = identification.fit_force_coefficients(cut, time, seen, time_shift=0.0)
    frequency, amplitude = identification.residual_spectrum(fit)
    peak = np.argmax(amplitude[:, 1])
    assert frequency[peak] == pytest.approx(730, abs=8)
    assert amplitude[peak, 1] == pytest.approx(8, rel=0.3)


@pytest.mark.slow
def test_runout_is_found():
    cut, time, seen = both(shift=0.4e-3, runout=10e-6)
    fit = identification.fit_force_coefficients(cut, time, seen, refine=["runout"])
    np.testing.assert_allclose(fit.refined["runout_x"], 10e-6, atol=0.5e-6)
    # Two teeth tell the difference of their radii only.
    assert math.isnan(fit.refined["runout_y"])
    np.testing.assert_allclose(found(fit), K, rtol=0.03)


def test_wrong_arguments_are_named():
    cut, time, seen = both()
    with pytest.raises(ValueError, match="`axes`"):
        identification.fit_force_coefficients(cut, time, seen, axes=("x", "x", "z"))
    with pytest.raises(ValueError, match="same length"):
        identification.fit_force_coefficients(cut, time[:1], seen)
    with pytest.raises(ValueError, match="must meet the cut"):
        identification.fit_force_coefficients(cut[0], time[0] + 9.0, seen[0])
    with pytest.raises(ValueError, match="radius"):
        identification.fit_force_coefficients(cut, time, seen, refine=["speed"])
