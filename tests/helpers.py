"""What several test modules share: references in NumPy, without dexels or JAX."""

import subprocess
import sys

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


def assert_adjoints_agree(derivative, *adjoints, rtol=1e-9, atol=None):
    """Compare a derivative by some adjoints with that through samples."""
    plain = derivative(ThroughSamples())
    scale = float(np.abs(plain).max())
    assert scale > 0
    for adjoint in adjoints or (process.ThroughRays(), process.ThroughPoses()):
        found = derivative(adjoint)
        limit = 1e-9 * scale if atol is None else atol
        np.testing.assert_allclose(found, plain, rtol=rtol, atol=limit)


def names(folder):
    """Return the names in a folder, sorted."""
    return sorted(path.name for path in folder.iterdir())


def cut_rms(run):
    """Return the contour error of a run or a case of it where the tool cuts [m]."""
    error = np.asarray(run.contour_error)[np.asarray(run.is_cutting).astype(bool)]
    return float(np.sqrt(np.mean(error**2)))


def python(code, **options):
    """Return a process that has run some code."""
    line = [sys.executable, "-c", code]
    return subprocess.run(line, capture_output=True, text=True, **options)


def relative(found, wanted):
    """Return the length of the difference over the length of what is wanted."""
    found, wanted = np.asarray(found), np.asarray(wanted)
    return np.linalg.norm(found - wanted) / np.linalg.norm(wanted)
