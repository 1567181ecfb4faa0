"""The file of `diffmill learn`: what it names, its faults, and the table `[learnt]`."""

import dataclasses

import numpy as np
import pytest
import xarray
from slides_job import write_slides_job

import diffmill as dm
from diffmill import learning as dl
from diffmill.cli import main
from diffmill.config import load_learning
from diffmill.io import write_path_csv

TRACKER = """
[part.tracker]
file = "tracker.csv"
noise = "2 um"
"""
HEAD = 'job = "job.toml"\n[[part]]\n'


@pytest.fixture
def folder(tmp_path):
    """Return a folder with a job and made-up measurements of its program."""
    job = dm.load_job(write_slides_job(tmp_path))
    time, tips = np.asarray(job.path.time), np.asarray(job.path.positions)
    rows = np.c_[time, 1e3 * tips][1:]

    def write(name, head, values):
        np.savetxt(tmp_path / name, values, delimiter=",", header=head, comments="")

    write("tracker.csv", "time [s],x [mm],y [mm],z [mm]", rows)
    write("inches.csv", "time [s],x [m],y [m],z [m]", rows)
    write(
        "late.csv", "time [s],x [mm],y [mm],z [mm]", rows + np.array([100.0, 0, 0, 0])
    )
    write("back.csv", "time [s],x [mm],y [mm],z [mm]", rows[::-1])
    write("forces.csv", "time [s],Fx [N],Fy [N],Fz [N]", rows)
    walls = np.c_[rows[100:110, 1:], np.tile([0.0, -1.0, 0.0], (10, 1))]
    write("points.csv", "x [mm],y [mm],z [mm],nx,ny,nz", walls)
    (tmp_path / "cut.csv").write_text(write_path_csv(job.path))
    return tmp_path


def load(folder, text):
    (folder / "learn.toml").write_text(text)
    return load_learning(folder / "learn.toml")


def problems(folder, text):
    with pytest.raises(dm.JobError) as error:
        load(folder, text)
    return " ".join(error.value.problems)


def test_parts_are_read_with_all_that_was_measured(folder):
    text = (
        'job = "job.toml"\nsteps = 2\n[prior]\nbacklash = "50 urad"\n[[part]]\n'
        f'name = "first"\ncommanded = "cut.csv"\n{TRACKER}'
        '[part.forces]\nfile = "forces.csv"\nnoise = "5 N"\non = "workpiece"\n'
        '[[part]]\n[part.points]\nfile = "points.csv"\nnoise = "3 um"\n'
    )
    found = load(folder, text)
    assert found.part_names == ("first", "part 2") and found.steps == 2
    assert isinstance(found.prior, dl.MachinePrior)
    assert found.prior.backlash == pytest.approx(5e-5)
    assert found.prior.servo == dl.MachinePrior().servo
    tracker, forces = found.parts[0].measurements
    (points,) = found.parts[1].measurements
    assert isinstance(tracker, dl.TrackedTips)
    assert isinstance(forces, dl.MeasuredForces)
    assert isinstance(points, dl.WallPoints)
    path = np.asarray(found.job.path.positions)
    np.testing.assert_allclose(tracker.tips, path[1:], atol=1e-12)
    np.testing.assert_allclose(forces.force, -1e3 * path[1:], atol=1e-9)
    np.testing.assert_allclose(points.points, path[101:111], atol=1e-12)
    np.testing.assert_allclose(found.parts[0].commanded, path, atol=1e-9)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (HEAD, 'part 1": found no measurement, but one of tracker'),
        (HEAD + TRACKER.replace("tracker.csv", "none.csv"), "no such file"),
        (HEAD + TRACKER.replace("tracker.csv", "inches.csv"), "not about the program"),
        (HEAD + TRACKER.replace("tracker.csv", "late.csv"), "counted from its begin"),
        (HEAD + TRACKER.replace("tracker.csv", "back.csv"), "do not increase"),
        (HEAD + TRACKER.replace("tracker.csv", "points.csv"), "no column for time"),
        (HEAD + TRACKER.replace('"2 um"', "2"), "noise"),
        (HEAD + TRACKER.replace("part.tracker", "part.forces"), "found 'tracker"),
        (HEAD + TRACKER + "speed = 1\n", "speed"),
        ('job = "job.toml"\n', "part"),
        (HEAD + TRACKER + '[prior]\nlearnt = "cut.csv"\n', "`diffmill learn` has"),
        (HEAD + 'commanded = "tracker.csv"\n' + TRACKER, "commanded"),
        (
            HEAD + '[part.encoders]\nfile = "tracker.csv"\nnoise = "9 urad"\n',
            "a robot with slides",
        ),
    ],
)
def test_a_fault_is_named(folder, text, fault):
    if fault == "found 'tracker":
        fault = "no column for Fx"
        text = text.replace('"2 um"', '"2 N"')
    assert fault in problems(folder, text)


def test_a_job_in_place_of_the_file_is_told_so(folder):
    with pytest.raises(dm.JobError) as error:
        load_learning(folder / "job.toml")
    (problem,) = error.value.problems
    assert problem.startswith("found a job; ") and 'as job = "job.toml"' in problem


def posterior(job):
    """Return a machine with friction along x, and a process."""
    machine = dl.AdaptableMachine.of_job(job.with_precision(), dl.MachinePrior())
    mean = np.zeros(machine.count)
    mean[machine.group("friction").index[0]] = 0.5
    mean[machine.group("field").index[:2]] = [0.1, -0.2]
    desired = np.asarray(job.path.positions, np.float64)
    return dl.MachinePosterior(
        mean=mean,
        covariance=np.diag(1e-2 * np.ones(machine.count)),
        sizes=machine.sizes,
        names=machine.names,
        center=machine.center,
        desired=desired,
        disturbance=1e-6 * np.sin(1e3 * desired),
        uncertainty=1e-7 * np.ones_like(desired),
        normals=np.tile([0.0, 1.0, 0.0], (len(desired), 1)),
    )


def test_a_job_has_the_machine_that_was_learnt(folder):
    """Its parameters for any program, what none explains for its own alone."""
    job = dm.load_job(folder / "job.toml")
    known = posterior(job)
    known.to_dataset().to_netcdf(folder / "learnt.nc", engine="h5netcdf")
    text = (folder / "job.toml").read_text() + '[learnt]\nfile = "learnt.nc"\n'
    (folder / "job.toml").write_text(text)
    found = dm.load_job(folder / "job.toml")
    assert found.notes[-1].endswith("and what no parameter explains")
    assert job.robot is not None and found.robot is not None
    assert found.robot.friction is not None
    spring = float(job.robot.joint_stiffness[0])
    friction = np.asarray(found.robot.friction.coulomb)
    np.testing.assert_allclose(friction[0], 0.5 * 2e-5 * spring)
    field = np.array([3e-6, -6e-6, 0.0])
    wanted = known.disturbance + field
    beyond = np.asarray(found.path.disturbance)
    np.testing.assert_allclose(beyond, wanted, atol=1e-12)
    program = (folder / "part.ngc").read_text()
    (folder / "part.ngc").write_text(program.replace("X6", "X5"))
    other = dm.load_job(folder / "job.toml")
    assert "is of another program" in other.notes[-1]
    away = np.asarray(other.path.disturbance) - field
    np.testing.assert_allclose(away, 0.0, atol=1e-12)
    assert "name that file as learnt in [prior]" in problems(folder, HEAD + TRACKER)


def test_another_machine_is_refused(folder):
    job = dm.load_job(folder / "job.toml")
    known = posterior(job)
    other = dataclasses.replace(known, names=tuple(f"{n}!" for n in known.names))
    other.to_dataset().to_netcdf(folder / "learnt.nc", engine="h5netcdf")
    text = (folder / "job.toml").read_text()
    (folder / "job.toml").write_text(text + '[learnt]\nfile = "learnt.nc"\n')
    with pytest.raises(dm.JobError, match="joints and force coefficients"):
        dm.load_job(folder / "job.toml")
    (folder / "job.toml").write_text(text + '[learnt]\nfile = "cut.csv"\n')
    with pytest.raises(dm.JobError, match="`diffmill learn` has written"):
        dm.load_job(folder / "job.toml")


def test_machines_are_drawn_as_they_are_said_to_scatter(folder):
    job = dm.load_job(folder / "job.toml").with_precision()
    known = posterior(job)
    jobs = known.drawn_jobs(job, 60, seed=3)
    springs = lambda one: np.asarray(one.robot.joint_stiffness)
    away = np.log(np.stack([springs(one) for one in jobs]) / springs(job))
    # A tenth of the prior's 10 %.
    np.testing.assert_allclose(away.std(), 0.01, rtol=0.15)
    coulomb = lambda one: np.asarray(one.robot.friction.coulomb)
    friction = np.stack([coulomb(one) for one in jobs])
    np.testing.assert_allclose(friction[:, 0].mean(), 10.0, rtol=0.1)
    assert (friction >= 0).all()


def test_check_says_what_a_file_holds(folder, capsys):
    (folder / "learn.toml").write_text(HEAD + TRACKER)
    assert main(["check", str(folder / "learn.toml")]) == 0
    assert "part 1: TrackedTips" in capsys.readouterr().out


@pytest.mark.slow
def test_the_command_makes_the_next_part_better(here, capsys):
    """A tracked part on a machine with friction, gaps and other springs and forces."""
    file = write_slides_job(here)
    job = dm.load_job(file).with_precision()
    truth = dm.TruthSettings(
        backlash=1e-5, friction=1e-5, presliding=2e-6, links=0.0, link_angles=2e-4
    )
    machine = dm.sim.drawn_machine(job, truth)
    run, noise = dm.simulate(machine), 2e-6
    made, program = dl.wall_times(run), np.asarray(run.time)
    desired = np.stack([np.interp(made, program, x) for x in np.asarray(run.desired).T])
    tips = desired.T + np.asarray(run.surface_deviation)
    tips = tips + noise * np.random.default_rng(1).normal(size=tips.shape)
    head = "time [s],x [mm],y [mm],z [mm]"
    rows = np.c_[made, 1e3 * tips][made > 0]
    np.savetxt("tracker.csv", rows, delimiter=",", header=head, comments="")
    prior = '[prior]\nfriction = "10 urad"\nbacklash = "10 urad"\n'
    (here / "learn.toml").write_text(HEAD + TRACKER + prior)
    assert main(["learn", "learn.toml"]) == 0
    said, out = capsys.readouterr().out, here / "learn-learn"
    for part in ("friction x", "causes, across the path", "are expected with what"):
        assert part in said
    assert said.strip().startswith((out / "summary.txt").read_text().strip()[:60])
    for name in ("corrected.ngc", "report.html", "causes.png", "learnt.png"):
        assert (out / name).stat().st_size > 1000
    page = (out / "report.html").read_text(encoding="utf-8")
    for title in ("What the parts show", "Causes", "Estimates", "Assumptions"):
        assert f"<h2>{title}</h2>" in page
    assert 'data-label="quantity">friction x<' in page and len(page) < 3e6
    told = np.asarray(dm.io.read_path_csv(out / "corrected.csv").positions)
    nominal = np.asarray(dm.correct(job).commanded)
    left = [dm.simulate(machine, commanded=u).contour.rms for u in (nominal, told)]
    assert left[1] < 0.6 * left[0]
    with xarray.open_dataset(out / "result.nc") as result:
        expected = result.attrs["learnt_expected_rms"]
    assert 0.5 * expected < left[1] < 2 * expected
    # The table that it writes makes the job of the next run.
    table = (out / "learnt.toml").read_text()
    file.write_text(file.read_text() + table)
    found = dm.simulate(dm.load_job(file), commanded=told).contour.rms
    said = float(said.split("the next one leaves ")[1].split()[0])
    np.testing.assert_allclose(1e6 * found, said, atol=0.02)


def test_advice_is_ranked_and_kept(here, monkeypatch, capsys):
    """What the command prints of trials; what they tell is made up."""
    job = write_slides_job(here)
    text = job.read_text()
    adaptive = '[simulation]\nresolution = "adaptive"\n'
    job.write_text(text.replace("[simulation]\n", adaptive))
    asked = {}

    def advise(job, known, trials, *, on_progress):
        asked.update(names=list(trials), known=known)
        on_progress("the part", 0.0)
        return dl.Advice("air", 3e-6), dl.Advice("", 9e-6)

    monkeypatch.setattr(dl, "advise", advise)
    (here / "learn.toml").write_text(
        'job = "job.toml"\n[prior]\nstiffness = 0.3\n[[trial]]\njob = "job.toml"\n'
    )
    assert main(["learn", "learn.toml", "--advise"]) == 0
    said, told = capsys.readouterr()
    assert "air" in said and "9.00 um" in said
    assert told.count("the engagement is updated in every tooth period") == 1
    assert (here / "learn-advise" / "summary.txt").read_text() in said
    page = (here / "learn-advise" / "report.html").read_text()
    assert "<b>Measure next: air.</b> It would leave 3 um rms" in page
    assert "the engagement is updated in every tooth period" in page
    assert asked["names"][0] == "this part under a tracker"
    assert asked["names"][-1] == "job.toml"
    np.testing.assert_array_equal(asked["known"].sizes[:3], 0.3)
    # Without the option a part is required, and nothing is written.
    assert main(["learn", "learn.toml"]) == 2
    assert "a measured part is required" in capsys.readouterr().err
    assert not (here / "learn-learn").exists()


def test_an_interrupted_run_goes_on_from_its_checkpoint(folder, monkeypatch, capsys):
    (folder / "learn.toml").write_text(HEAD + TRACKER)
    monkeypatch.chdir(folder)
    arrays, resumed = {"step": np.asarray(1), "parameters": np.arange(3.0)}, []

    def interrupted(job, parts, *, on_checkpoint, resume, **settings):
        resumed.append(resume)
        on_checkpoint(arrays)
        raise KeyboardInterrupt

    monkeypatch.setattr(dl, "learn", interrupted)
    file = folder / "learn-learn.checkpoint"
    assert main(["learn", "learn.toml"]) == 1
    assert f"{file.name} keeps what was found" in capsys.readouterr().err
    assert main(["learn", "learn.toml"]) == 2
    assert "--resume goes on from there" in capsys.readouterr().err
    assert main(["learn", "learn.toml", "--resume"]) == 1
    assert resumed[0] is None and len(resumed) == 2
    for name, values in arrays.items():
        np.testing.assert_array_equal(resumed[1][name], values)
    # Of other measurements the checkpoint is of no use.
    (folder / "learn.toml").write_text(HEAD + TRACKER.replace("2 um", "3 um"))
    capsys.readouterr()
    assert main(["learn", "learn.toml", "--resume"]) == 2
    assert "a checkpoint of another job" in capsys.readouterr().err
