"""What several test modules share: references in NumPy, without dexels or JAX."""

import numpy as np

import diffmill.cutting as cutting
import diffmill.process as process

# Coefficients of the paper's test, aluminium 3.1325 [Pa, N/m].
PAPER_LAW = cutting.LinearEdgeLaw(
    K_tc=989.8e6, K_rc=337.3e6, K_ac=66.9e6, K_te=3.0e3, K_re=15.4e3, K_ae=4.5e3
)


class ThroughSamples(process.AbstractAdjoint):
    """Differentiate what samples read as any other array: a reference for the others.

    Every step keeps what it read of the stock, and its transpose scatters into it.
    """

    def removal_poses(self, poses):
        return poses

    def with_pose_derivatives(self, track, raw):
        del track, raw


def relative(found, wanted):
    """Return the length of the difference over the length of what is wanted."""
    found, wanted = np.asarray(found), np.asarray(wanted)
    return np.linalg.norm(found - wanted) / np.linalg.norm(wanted)
