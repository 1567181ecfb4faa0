"""The force of a slot in NumPy: an independent program for what is identified."""

import math

import numpy as np

K = np.array([958.86e6, 250.863e6, 146.361e6, 15.758e3, 19.434e3, 18.207e3])
SPEED = 6000 * 2 * math.pi / 60
PERIOD = math.pi / SPEED
R, DEPTH, HELIX = 5e-3, 2e-3, math.radians(30)


def slot_force(time, feed, runout=0.0):
    """Return the force by fine discs and chips between two circles, two teeth."""
    z = (np.arange(100) + 0.5) * DEPTH / 100
    total = np.zeros((len(time), 3))
    for tooth in range(2):
        lag = z[None] * math.tan(HELIX) / R
        phi = SPEED * time[:, None] + math.pi * tooth - lag
        # The tooth before stands out by the opposite of what this one does; along a
        # helix the edge turns out of the direction of the run-out.
        more = 2 * runout * (1 - 2 * tooth) * np.cos(lag)
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


def mean_lines(feeds, coefficients, entry=0.0, leave=math.pi):
    """Return mean forces of two teeth 3 mm deep by a sum over the immersion angle."""
    count = 4000
    phi = entry + (leave - entry) * (np.arange(count) + 0.5) / count
    h = feeds[:, None] * np.sin(phi)
    F_t, F_r, F_a = (coefficients[i] * h + coefficients[3 + i] for i in range(3))
    F_x = -F_t * np.cos(phi) - F_r * np.sin(phi)
    F_y = F_t * np.sin(phi) - F_r * np.cos(phi)
    share = 2 * 3e-3 * (leave - entry) / (2 * math.pi)
    return share * np.mean([F_x, F_y, F_a], axis=2).T
