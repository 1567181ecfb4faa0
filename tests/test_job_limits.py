"""The gouge limit in a whole job: kept by the command that comes out."""

import numpy as np
import pytest
from helpers import cut_rms
from slides_job import write_slides_job

import diffmill as dm
from diffmill.correction import FinishedSurface, InfeasibleLimit
from diffmill.workpiece import SurfaceError

# A wall in two passes; the arm still rings when the second, of 8 um, begins.
PROGRAM = """G21 G17 G90 G94
G0 X-5.3 Y-2.008 Z1
G0 Z-0.8
G1 X6 F3000
G1 Y-4
G1 X-5.3
G1 Y-2
G1 X6
M2
"""
GOUGE = 2.5e-6
UNBOUND = "acceleration_factor = inf"
pytestmark = pytest.mark.slow


class Free:
    """The job without further limits, with the baselines that all jobs share."""

    def __init__(self, folder):
        self.folder, self.kept = folder, {}
        self.job, self.result = self.correct("max_steps = 3", UNBOUND)

    def correct(self, *lines):
        job = dm.load_job(write_slides_job(self.folder, *lines, program=PROGRAM))

        def keep(arrays):
            self.kept.update({k: arrays[k] for k in arrays if k.startswith("method/")})

        known = {k: v for k, v in self.kept.items() if "/corrected/" not in k}
        result = dm.correct(
            job, resume=known or None, on_checkpoint=None if known else keep
        )
        return job, result


@pytest.fixture(scope="module")
def free(tmp_path_factory):
    return Free(tmp_path_factory.mktemp("slides"))


def again(job, result):
    """Simulate the command anew, as from a file with 1e-12 m."""
    return dm.simulate(job, commanded=np.round(result.commanded, 12))


def errors(job, solution):
    surface = FinishedSurface.from_cut(
        solution.rigid.stock,
        job.path.positions,
        job.cutter.nominal_radius,
        shares=np.asarray(solution.wall_share),
    )
    made = np.asarray(solution.desired) + np.asarray(solution.surface_deviation)
    return np.asarray(surface.errors(made))


def test_the_gouge_limit_is_kept_and_costs_little(free):
    job, result = free.correct("max_steps = 3", UNBOUND, f'gouge = "{1e6 * GOUGE} um"')
    after = again(job, result)
    assert -errors(job, result.before).min() > 3 * GOUGE
    assert -errors(job, after).min() <= GOUGE + 1e-10
    assert cut_rms(after) < 0.2 * cut_rms(result.before)
    assert cut_rms(after) < 2 * result.methods["inverse_drive"].measures.rms
    # The dexels tell the same, which know nothing of the bounds. Where wall and floor
    # meet, a point may be off by both. The mesh of the ideal is exact for planes only.
    machined = SurfaceError.of_stock(after.stock, after.rigid.stock)
    rows = machined.is_cut & (np.abs(machined.normal).max(axis=1) > 0.9999)
    assert -machined.error[rows].min() <= np.sqrt(2) * GOUGE


def test_without_a_limit_the_correction_cuts_deeper(free):
    """Otherwise the test above could not fail."""
    after = again(free.job, free.result)
    assert -errors(free.job, after).min() > 1.1 * GOUGE


def test_a_gouge_limit_that_cannot_be_held_is_refused(free):
    with pytest.raises(InfeasibleLimit) as refused:
        free.correct(UNBOUND, 'gouge = "0.5 um"', 'max_offset = "4 um"')
    assert "`gouge` is 0.5 um and cannot be held" in str(refused.value)
    assert "`max_offset` (" in str(refused.value)


def test_a_command_accelerates_so_many_times_as_much_as_the_program(free):
    job, result = free.correct("max_steps = 1", "acceleration_factor = 1.5")

    def largest(positions):
        steps = np.diff(np.asarray(positions), 2, axis=0)
        return np.abs(steps).max() / float(job.tooth_period) ** 2

    own = largest(job.path.positions)
    assert largest(free.result.commanded) > 1.6 * own
    assert largest(result.commanded) <= 1.5 * own * (1 + 1e-5)
    assert cut_rms(result.after) < cut_rms(result.before)
