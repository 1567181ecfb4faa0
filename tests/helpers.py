"""What several test modules share: references in NumPy, without dexels or JAX."""

import numpy as np

import diffmill.cutting as cutting

# Coefficients of the paper's test, aluminium 3.1325 [Pa, N/m].
PAPER_LAW = cutting.LinearEdgeLaw(
    K_tc=989.8e6, K_rc=337.3e6, K_ac=66.9e6, K_te=3.0e3, K_re=15.4e3, K_ae=4.5e3
)


def relative(found, wanted):
    """Return the length of the difference over the length of what is wanted."""
    found, wanted = np.asarray(found), np.asarray(wanted)
    return np.linalg.norm(found - wanted) / np.linalg.norm(wanted)
