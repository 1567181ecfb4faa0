"""A joint with spring, friction, gap and a late encoder, as its records show it."""

import dataclasses

import numpy as np
from scipy.signal import lfilter

from diffmill.identification import JointRecord

STEP = 4e-3


@dataclasses.dataclass(frozen=True)
class Joint:
    """A joint whose link bears a weight; its motor has friction and mass of its own."""

    stiffness: float = 5e6
    friction: float = 150.0
    motor_friction: float = 250.0
    presliding: float = 80e-6
    backlash: float = 40e-6
    delay: float = 2.9e-3
    viscous: float = 1500.0
    weight: float = 900.0
    wave: float = 0.0

    def record(self, rng, noise=10e-6, torque_noise=30.0, duration=20.0):
        """Return a record of slow waves with noise that is correlated in time."""
        t = np.arange(0, duration, STEP)
        q = np.zeros_like(t)
        for _ in range(5):
            own, phase = 2 * np.pi * rng.uniform(0.08, 0.31), rng.uniform(0, 2 * np.pi)
            q += rng.normal() * np.sin(own * t + phase)
        x = np.clip(t / 2, 0, 1)
        q *= 0.35 / np.std(q) * x**3 * (10 - 15 * x + 6 * x**2)
        v = np.gradient(q, STEP)
        a = np.gradient(v, STEP)
        s = stretches(q, self.presliding)
        spring = self.weight * np.sin(q + 0.3) + 400 * a + self.friction * s
        torque = spring + 200 * a + self.motor_friction * s + self.viscous * v
        link = q - spring / self.stiffness - self.backlash / 2 * np.sign(spring)
        link = link + self.wave * np.sin(12 * q) + 60e-6
        link = np.interp(t - self.delay, t, link) + coloured(rng, len(t), 0.96, noise)
        torque = torque + coloured(rng, len(t), 0.9, torque_noise)
        return JointRecord(
            "joint.csv", STEP, q[:, None], link[:, None], torque[:, None]
        )


def stretches(q, presliding):
    """Return the share of its sliding friction that a joint is held by."""
    z, shares = 0.0, []
    for travel in np.diff(q, prepend=q[0]):
        z = min(max(z + travel, -presliding), presliding)
        shares.append(z / presliding)
    return np.array(shares)


def coloured(rng, count, memory, size):
    """Return noise of a size, of which a share stays from sample to sample."""
    white = rng.normal(size=count)
    return size * lfilter([np.sqrt(1 - memory**2)], [1, -memory], white)


def save_joint(file, record):
    """Write a record as a table of degrees and N m."""
    t = STEP * np.arange(len(record.motor))
    columns = [t, np.rad2deg(record.motor), np.rad2deg(record.link), record.torque]
    head = "time_s,motor_1_deg,link_1_deg,torque_1_Nm"
    np.savetxt(file, np.column_stack(columns), delimiter=",", header=head, comments="")
