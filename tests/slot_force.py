"""The force of a slot in NumPy: an independent program for what is identified."""

import math

import numpy as np
from references.trochoid import TrochoidCut

K = np.array([958.86e6, 250.863e6, 146.361e6, 15.758e3, 19.434e3, 18.207e3])
SPEED = 6000 * 2 * math.pi / 60
PERIOD = math.pi / SPEED
R, DEPTH, HELIX = 5e-3, 2e-3, math.radians(30)


def slot_force(time, feed, runout=0.0):
    """Return the force of two teeth on trochoids, the offset towards tooth 0."""
    cut = TrochoidCut(K, feed, DEPTH, SPEED, R, helix=HELIX, runout=runout, slices=100)
    return cut.force(time)


def mean_of_slots(feeds, depth):
    """Return mean forces of two straight teeth on trochoids in slots."""
    turn, count = 2 * math.pi / SPEED, 20_000
    time = turn * (np.arange(count) + 0.5) / count
    cuts = (TrochoidCut(K, f, depth, SPEED, R, slices=1) for f in feeds)
    return np.stack([cut.force(time).mean(axis=0) for cut in cuts])


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
