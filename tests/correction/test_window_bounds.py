"""Bounds of the surface in segments: held in each, as for the whole path."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from correction.test_held import (
    PATIENT,
    RADIUS,
    ROWS,
    TIME_STEP,
    Pushed,
    leaving,
    pushed,
    straight_wall,
)

from diffmill.correction import (
    AbstractPieces,
    FinishedSurface,
    GaussNewton,
    InfeasibleLimit,
    Problem,
    RecedingHorizon,
    SurfaceBounds,
)
from diffmill.workpiece import box


class PushedPieces(AbstractPieces):
    """The same, piece by piece."""

    whole: Pushed

    def begin(self, command):
        """Remember nothing."""
        return jnp.zeros(())

    def piece(self, state, rows):
        """Return some rows."""
        return jax.tree.map(lambda x: x[rows], self.whole)


def segments(problem, bounds):
    method = GaussNewton(70e-3, solver=PATIENT, bounds=bounds)
    pieces = PushedPieces(problem.plant)
    return RecedingHorizon(pieces, method, horizon=110, overlap=60)(problem)


@pytest.fixture(scope="module")
def gouge():
    """Return a limit that the correction without one would break."""
    problem, surface = pushed()
    free = GaussNewton(70e-3, solver=PATIENT)(problem)
    return -0.6 * float(np.asarray(surface.errors(free.motion.actual)).min())


@pytest.mark.slow
def test_segments_hold_the_gouge_limit_as_the_whole_path_does(gouge):
    problem, surface = pushed()
    bounds = SurfaceBounds.about(surface, gouge=gouge)
    found = segments(problem, bounds)
    assert found.detail["segment_count"] == 3
    errors = np.asarray(surface.errors(found.motion.actual))
    assert 0.9 * gouge < -errors.min() <= gouge * (1 + 1e-9)
    whole = GaussNewton(70e-3, solver=PATIENT, bounds=bounds)(problem)
    assert found.measures.rms < 1.05 * whole.measures.rms


@pytest.mark.slow
def test_a_limit_that_a_segment_cannot_hold_is_named(gouge):
    problem, surface = pushed(max_offset=5e-6)
    with pytest.raises(InfeasibleLimit) as refused:
        segments(problem, SurfaceBounds.about(surface, gouge=gouge))
    text = str(refused.value)
    assert f"`gouge` is {1e6 * gouge:.4g} um and cannot be held" in text
    assert "reaches `max_offset` (" in text


@pytest.mark.slow
def test_the_tool_stays_in_a_thin_layer_in_segments():
    """A program that is rewarded for leaving the wall may not leave the cut."""
    problem, surface = leaving()
    layers = np.full(len(surface.points), 1e-4)
    found = segments(problem, SurfaceBounds.about(surface, layers=layers))
    most = np.asarray(surface.errors(found.motion.actual)).max()
    assert 0.8e-4 < most <= 0.9e-4 * (1 + 1e-9)


@pytest.mark.slow
def test_segments_hold_a_floor_by_poses_that_are_sure_to_cover_it():
    """A tool that lags comes short of the points that its rim should just cover."""
    path, _ = straight_wall()
    stock = box([0.0, -8e-3, -2e-3], [32e-3, 8e-3, 0.0], 0.5e-3)
    surface = FinishedSurface.from_cut(stock, path, RADIUS)
    push = np.tile([-5e-5, 0.0, 5e-5], (ROWS, 1))
    plant = Pushed(jnp.asarray(path), jnp.asarray(push))
    # The lag stays: it is all that may be offset.
    problem = Problem(plant, path, path, np.ones(ROWS), TIME_STEP, 2e-5)
    layers = np.full(len(surface.points), 1e-4)
    found = segments(problem, SurfaceBounds.about(surface, layers=layers))
    most = np.asarray(surface.errors(found.motion.actual)).max()
    assert 0.0 < most <= 0.9e-4 * (1 + 1e-9)
