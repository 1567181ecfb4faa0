"""Machines that are drawn about a model."""

import dataclasses

import numpy as np
import pytest
from slides_job import write_slides_job

import diffmill as dm
from diffmill.settings.truth import TruthSettings

NONE = TruthSettings(
    stiffness=0.0,
    damping=0.0,
    force=0.0,
    force_bias=0.0,
    links=0.0,
    link_angles=0.0,
    backlash=0.0,
    friction=0.0,
    draws=1,
)


def coefficient(job):
    assert isinstance(job.law, dm.cutting.LinearEdgeLaw)
    return job.law.K_tc


def robot_of(job):
    assert job.robot is not None
    return job.robot


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    return dm.load_job(write_slides_job(tmp_path_factory.mktemp("job")))


def test_a_draw_of_no_size_is_the_model(job):
    machine = dm.sim.drawn_machine(job, NONE)
    model = job.with_precision()
    np.testing.assert_allclose(machine.T_base_work, model.T_base_work, atol=1e-12)
    assert robot_of(machine).friction is None and robot_of(machine).backlash is None
    np.testing.assert_allclose(
        robot_of(machine).joint_stiffness, robot_of(model).joint_stiffness, rtol=1e-12
    )
    tips = np.asarray(job.path.positions)
    found = dm.sim.TrueErrors.of_commands(job, NONE, {"program": tips})
    wanted = dm.simulate(job).contour.rms
    np.testing.assert_allclose(found.median("program"), wanted, rtol=1e-6)


def test_a_draw_has_the_sizes_that_are_asked_for(job):
    sizes = dataclasses.replace(
        NONE, stiffness=0.1, links=1e-3, force=0.2, force_bias=0.5, friction=2e-5
    )
    machines = [dm.sim.drawn_machine(job, sizes, k) for k in range(40)]
    K = np.asarray(robot_of(job).joint_stiffness)
    shares = np.array([robot_of(m).joint_stiffness / K - 1 for m in machines])
    assert np.abs(shares).max() <= 0.1 and np.abs(shares).max() > 0.09
    moved = np.array(
        [
            robot_of(m).placement_positions - robot_of(job).placement_positions
            for m in machines
        ]
    )
    assert np.abs(moved).max() <= 1e-3 and np.abs(moved).max() > 0.9e-3
    force = np.array([float(coefficient(m) / coefficient(job)) for m in machines])
    assert force.min() >= 1.5 * 0.8 - 1e-9 and force.max() <= 1.5 * 1.2 + 1e-9
    laws = [robot_of(m).friction for m in machines]
    bend = np.array([law.coulomb / K for law in laws if law is not None])
    assert len(bend) == 40
    np.testing.assert_allclose(bend, 2e-5)


def test_a_draw_repeats_by_its_seed_and_number(job):
    sizes = TruthSettings(seed=3)
    one, same, other = (dm.sim.drawn_machine(job, sizes, k) for k in (1, 1, 2))
    np.testing.assert_array_equal(
        robot_of(one).joint_stiffness, robot_of(same).joint_stiffness
    )
    assert np.any(robot_of(one).joint_stiffness != robot_of(other).joint_stiffness)
    seeds = dm.sim.drawn_machine(job, dataclasses.replace(sizes, seed=4), 1)
    assert np.any(robot_of(one).joint_stiffness != robot_of(seeds).joint_stiffness)


def test_a_job_states_the_machines(tmp_path):
    file = write_slides_job(tmp_path)
    text = file.read_text()
    file.write_text(text + '[truth]\nbacklash = "12 urad"\ndraws = 2\n')
    truth = dm.load_job(file).truth
    assert (truth.draws, truth.seed) == (2, 0)
    np.testing.assert_allclose(truth.backlash, 12e-6)
    file.write_text(text + '[truth]\nbacklash = "12 um"\ndraw = 2\n')
    with pytest.raises(dm.JobError) as error:
        dm.load_job(file)
    assert "[truth] backlash: found '12 um', but an angle" in str(error.value)
    assert "[truth] draw" in str(error.value)
