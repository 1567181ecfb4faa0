"""Machines that are drawn about a model."""

import dataclasses

import numpy as np
import pytest
from slides_job import ARM, ROBOT, write_slides_job

import diffmill as dm
from diffmill.settings.truth import TruthSettings
from small_job import problems_of, write_job

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


@pytest.mark.slow
def test_a_machine_may_need_more_intervals_than_the_model(job):
    thin = job.with_intervals((1, 1, 1))
    tips = np.asarray(job.path.positions)
    rigid = dm.sim.rigid_cut(thin.with_precision(), dm.process.FrozenStock())
    assert bool(rigid.result == dm.RESULTS.interval_overflow)
    found = dm.sim.TrueErrors.of_commands(thin, NONE, {"program": tips})
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


SIZES = {
    "bandwidth": (0.1, 0.1),
    "links": ("0.2 mm", 2e-4),
    "link_angles": ("0.1 mrad", 1e-4),
    "backlash": ("30 urad", 3e-5),
    "friction": ("20 urad", 2e-5),
    "presliding": ("4 urad", 4e-6),
    "registration": ("15 um", 1.5e-5),
    "registration_angles": ("0.05 mrad", 5e-5),
    "runout": ("4 um", 4e-6),
}
TEXT = {name: text for name, (text, _) in SIZES.items()}
IN_SI = {name: value for name, (_, value) in SIZES.items()}
TABLES = ("simulation.scatter", "correction.uncertainty", "truth")
SERVOS = {"controller": {"bandwidth": "10 Hz"}}


def load(folder, *changes):
    (folder / "arm.toml").write_text(ARM)
    return dm.load_job(write_job(folder, {"robot": ROBOT}, *changes))


def stated_sizes(job):
    found = job.simulation.scatter, job.correction.uncertainty, job.truth
    return [sizes for sizes in found if sizes is not None]


def test_three_tables_state_sizes_with_units(tmp_path):
    job = load(tmp_path, SERVOS, {table: TEXT for table in TABLES})
    for sizes in stated_sizes(job):
        found = {name: getattr(sizes, name) for name in IN_SI}
        assert found == pytest.approx(IN_SI)
        assert set(sizes.robot_errors) >= IN_SI.keys() - {"presliding"}
    plain = load(tmp_path, {"simulation.scatter": {}, "correction.uncertainty": {}})
    for sizes in stated_sizes(plain)[:2]:
        assert sizes.robot_errors == () and sizes.stiffness == sizes.force == 0.0


@pytest.mark.parametrize("table", TABLES)
@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"links": "1 mrad"}, ("links: found '1 mrad', but a length",)),
        ({"backlash": 3e-5}, ("backlash: found 3e-05",)),
        ({"friction": "-1 urad"}, ("friction", "at least 0")),
        ({"registration": "-1 um"}, ("registration", "at least 0")),
        ({"bandwidth": 0.1}, ("bandwidth", "needs [controller] with a bandwidth")),
        ({"bandwidth": 1.0}, ("bandwidth", "less than 1")),
        ({"servo": 0.1}, ("servo", "unknown key")),
    ],
)
def test_sizes_that_cannot_be_are_refused(tmp_path, table, changes, words):
    (tmp_path / "arm.toml").write_text(ARM)
    file = write_job(tmp_path, {"robot": ROBOT, table: changes})
    (problem,) = problems_of(file)
    assert problem.startswith(f"[{table.split('.')[0]}]")
    assert all(word in problem for word in words), problem


def test_a_machine_of_modes_has_no_joints_that_are_off(tmp_path):
    modes = [{"frequency": "50 Hz", "damping_ratio": 0.02, "mass": "1 kg"}]
    machine = {"modes": [mode | {"direction": [1, 0, 0]} for mode in modes]}
    changes = {"robot": None, "machine": machine}
    file = write_job(tmp_path, changes, {"correction.uncertainty": {"links": "1 mm"}})
    (problem,) = problems_of(file)
    assert "[correction] uncertainty links" in problem and "[machine]" in problem


def test_a_point_cloud_has_no_run_out(tmp_path):
    (tmp_path / "arm.toml").write_text(ARM)
    changes = {"robot": ROBOT, "simulation": {"chip": "point_cloud"}}
    (problem,) = problems_of(write_job(tmp_path, changes, {"truth.runout": "2 um"}))
    assert "[truth] runout" in problem and "point_cloud" in problem


def joints_of(machines, name):
    found = [getattr(robot_of(machine), name) for machine in machines]
    return [part for part in found if part is not None]


@pytest.mark.parametrize("is_gaussian", [False, True])
def test_an_uncertainty_draws_what_its_law_says(job, is_gaussian):
    size, count = 1e-5, 40
    sizes = dm.UncertaintySettings(
        stiffness=0.1, links=1e-4, backlash=size, friction=size, is_gaussian=is_gaussian
    )
    machines = [dm.sim.drawn_machine(job, sizes, k) for k in range(count)]
    K = np.asarray(robot_of(job).joint_stiffness)
    gaps = np.array([x.gap for x in joints_of(machines, "backlash")]) / size
    bends = np.array([x.coulomb / K for x in joints_of(machines, "friction")]) / size
    shares = np.array([robot_of(m).joint_stiffness / K for m in machines]) - 1
    positions = np.array([robot_of(m).placement_positions for m in machines])
    moved = (positions - np.asarray(robot_of(job).placement_positions)) / 1e-4
    assert gaps.shape == bends.shape == (count, 3)
    for positive in (gaps, bends):
        # Uniform from 0 to 1, or half-normal.
        mean = np.sqrt(2 / np.pi) if is_gaussian else 0.5
        square = 1.0 if is_gaussian else 1 / 3
        assert positive.min() > 0
        assert positive.mean() == pytest.approx(mean, rel=0.15)
        assert np.mean(positive**2) == pytest.approx(square, rel=0.3)
        assert (positive.max() > 1) == is_gaussian
    for signed in (shares / 0.1, moved):
        square = 1.0 if is_gaussian else 1 / 3
        assert abs(signed.mean()) < 0.2
        assert np.mean(signed**2) == pytest.approx(square, rel=0.3)


def test_a_part_is_displaced_beyond_what_touching_off_sees(job):
    """The tool is off by one displacement and one small rotation all over the part."""
    sizes = dataclasses.replace(NONE, registration=1e-4, registration_angles=1e-3)
    model, machine = (dm.sim.drawn_machine(job, s) for s in (NONE, sizes))
    assert machine.nominal is not None and model.nominal is not None
    points = np.asarray(job.path.positions)
    base = lambda x: (
        points @ np.asarray(x.T_base_work)[:3, :3].T + np.asarray(x.T_base_work[:3, 3])
    )
    middle = np.asarray(model.nominal.probes).mean(0)
    moved = base(machine) - base(model)
    arms = np.column_stack([np.ones(len(points)), points - middle])
    fit, *_ = np.linalg.lstsq(arms, moved, rcond=None)
    shift, slope = fit[0], fit[1:].T
    assert 0 < np.abs(shift).max() <= 1e-4
    turn = np.array([slope[2, 1], slope[0, 2], slope[1, 0]])
    assert 0 < np.abs(turn).max() <= 1e-3
    np.testing.assert_allclose(slope[:2, :2] + slope[:2, :2].T, 0, atol=2e-6)
    # Touched off once more it is where it was: the error stays with the machine.
    again = machine.touched_off().T_base_work
    np.testing.assert_allclose(again, machine.T_base_work, atol=1e-12)


def test_servos_are_off_each_by_its_share(tmp_path):
    job = load(tmp_path, SERVOS)
    sizes = dataclasses.replace(NONE, bandwidth=0.2)
    found = [dm.sim.drawn_machine(job, sizes, k).controller for k in range(20)]
    shares = np.array([x.bandwidth for x in found if x is not None]) / 10 - 1
    assert shares.shape == (20, 3)
    assert 0.15 < np.abs(shares).max() <= 0.2
    ideal = dataclasses.replace(job, controller=None)
    with pytest.raises(ValueError, match="`sizes` must have no bandwidth"):
        dm.sim.drawn_machine(ideal, sizes)


@pytest.mark.slow
def test_run_out_of_a_drawn_machine_cuts(tmp_path):
    job = load(tmp_path)
    machine = dm.sim.drawn_machine(job, dataclasses.replace(NONE, runout=2e-5))
    stated = load(tmp_path, {"cutter.runout": "20 um"})
    drawn, known = (
        dm.sim.rigid_cut(x.with_precision(), dm.process.FrozenStock()).force
        for x in (machine, stated)
    )
    plain = dm.sim.rigid_cut(job.with_precision(), dm.process.FrozenStock()).force
    size = np.abs(known - plain).max()
    assert size > 1.0
    np.testing.assert_allclose(drawn, known, atol=0.1 * size)
