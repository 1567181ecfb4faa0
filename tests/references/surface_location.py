"""Where a vibrating tool leaves the wall: the frequency-domain solution, in NumPy.

After T. L. Schmitz and B. P. Mann, Closed-form solutions for surface location error in
milling, International Journal of Machine Tools and Manufacture 46 (2006): the force of
a rigid cut repeats with every tooth, so that its Fourier series through the receptance
of the tool gives the periodic vibration; a wall point is made by a tooth that looks at
it, and holds the vibration of that instant. Regeneration adds nothing to a motion that
is the same for every tooth.
"""

import math

import numpy as np


def tooth_force(law, feed, arc, radial_direction, *, teeth, lags=(0.0,), samples=4096):
    """Return the force on the tool along a direction over one tooth period [N/m].

    Args:
        law: Coefficients, with `K_tc`, `K_rc`, `K_te` and `K_re`.
        feed: Feed per tooth [m], a vector along work x and y, shape (2,).
        arc: Entry and exit, immersion angles [rad].
        radial_direction: Unit vector along which the force is taken, shape (2,).
        teeth: Number of teeth.
        lags: Angles by which the helix holds back thin discs of equal height [rad].
        samples: Samples of the period.

    Returns:
        Mean over the discs of the force per axial depth, shape (sample,); at sample 0 a
        tooth looks along +y at the tip.
    """
    turn = 2 * math.pi / teeth * np.arange(samples) / samples
    total = np.zeros(samples)
    for lag in lags:
        for j in range(teeth):
            phi = turn + 2 * math.pi * j / teeth - lag
            outward = np.stack([np.sin(phi), np.cos(phi)], axis=-1)
            along = np.stack([np.cos(phi), -np.sin(phi)], axis=-1)
            h = outward @ np.asarray(feed)
            is_in = np.mod(phi - arc[0], 2 * math.pi) < arc[1] - arc[0]
            is_in &= h > 0
            push = -(law.K_tc * h + law.K_te)[:, None] * along
            push -= (law.K_rc * h + law.K_re)[:, None] * outward
            total += np.where(is_in, push @ np.asarray(radial_direction), 0.0)
    return total / len(lags)


def periodic_motion(force, period, receptance):
    """Return the motion [m] under a periodic force [N], samples of one period.

    Args:
        force: Samples, shape (sample,).
        period: Tooth period [s].
        receptance: Complex receptance at angular frequencies [rad/s] in [m/N].
    """
    lines = np.fft.rfft(force)
    omega = 2 * math.pi * np.arange(lines.size) / period
    return np.fft.irfft(lines * receptance(omega), force.size)


def at_angle(motion, angle, *, teeth):
    """Return a periodic motion at the instant at which a tooth looks along an angle."""
    place = np.mod(np.asarray(angle) * teeth / (2 * math.pi), 1.0) * motion.size
    return np.interp(place, np.arange(motion.size + 1), np.append(motion, motion[0]))


def one_mode(frequency, ratio, stiffness):
    """Return the receptance of one mode [Hz, -, N/m]."""

    def receptance(omega):
        share = omega / (2 * math.pi * frequency)
        return 1 / stiffness / (1 - share**2 + 2j * ratio * share)

    return receptance
