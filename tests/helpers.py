"""What several test modules share: references in NumPy, without dexels or JAX."""

import math

import numpy as np

import diffmill.cutting as cutting

# Coefficients of the paper's test, aluminium 3.1325 [Pa, N/m].
PAPER_LAW = cutting.LinearEdgeLaw(
    K_tc=989.8e6, K_rc=337.3e6, K_ac=66.9e6, K_te=3.0e3, K_re=15.4e3, K_ae=4.5e3
)


def quadrature_mean_force(
    law, feed, entry, exit, axial_depth, radius=5e-3, teeth=2, is_two_circle=True
):
    """Return the mean force of a straight cut along +x, by fine quadrature.

    With `is_two_circle` the chip lies between two circles one feed apart and also
    begins where they cross, a little before angle 0; else h = f sin(phi).
    """
    phi = np.linspace(-0.5, math.pi + 0.5, 400_001)
    step = phi[1] - phi[0]
    if is_two_circle:
        h = radius + feed * np.sin(phi) - np.sqrt(radius**2 - (feed * np.cos(phi)) ** 2)
        low = -1.0 if entry == 0 else entry
        high = 4.0 if exit == math.pi else exit
    else:
        h, low, high = feed * np.sin(phi), entry, exit
    is_in = (h > 0) & (phi >= low) & (phi <= high)
    F_t = (law.K_tc * h + law.K_te) * is_in
    F_r = (law.K_rc * h + law.K_re) * is_in
    F_a = (law.K_ac * h + law.K_ae) * is_in
    share = teeth * axial_depth * step / (2 * math.pi)
    return share * np.array(
        [
            np.sum(-F_t * np.cos(phi) - F_r * np.sin(phi)),
            np.sum(F_t * np.sin(phi) - F_r * np.cos(phi)),
            np.sum(F_a),
        ]
    )


def relative(found, wanted):
    """Return the length of the difference over the length of what is wanted."""
    found, wanted = np.asarray(found), np.asarray(wanted)
    return np.linalg.norm(found - wanted) / np.linalg.norm(wanted)
