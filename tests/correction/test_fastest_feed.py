"""The largest feed within a tolerance, a force, a power and the speeds of joints."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from slides_job import write_slides_job

import diffmill as dm
from diffmill.correction import fastest_feed


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    return dm.load_job(
        write_slides_job(tmp_path_factory.mktemp("job"))
    ).with_precision()


@pytest.mark.slow
def test_the_next_faster_feed_breaks_the_limit_that_is_named(job):
    run = dm.simulate(job)
    error = run.contour.max
    found = fastest_feed(job, 1.3 * error)
    assert found.best is not None and found.path is not None
    assert found.best.override > 1 and found.limited_by == "tolerance"
    beyond = min(x.override for x in found.tried if x.broken)
    assert beyond < 1.021 * found.best.override
    # What is written is what was tried.
    again = dm.simulate(dataclasses.replace(job, path=found.path))
    np.testing.assert_allclose(again.contour.max, found.best.error, rtol=1e-6)
    # Half of what the program has: a slower one, if any.
    slow = fastest_feed(job, 0.7 * error)
    assert slow.best is None or slow.best.override < 1


@pytest.mark.slow
def test_speeds_of_joints_forces_and_power_are_limits(job):
    assert job.robot is not None
    feed = 0.05
    speeds = np.array([1.2 * feed, 1.2 * feed, 10.0])
    robot = dataclasses.replace(job.robot, joint_speed=jnp.asarray(speeds))
    slow = dataclasses.replace(job, robot=robot)
    found = fastest_feed(slow, 1.0)
    assert found.limited_by == "joint speed" and found.best is not None
    assert 1.1 < found.best.override < 1.3
    force = float(np.linalg.norm(np.asarray(dm.simulate(job).force), axis=1).max())
    held = fastest_feed(job, 1.0, max_force=1.05 * force)
    assert held.limited_by == "force"
    assert held.best is not None and held.best.force <= 1.05 * force
    power = float(dm.simulate(job).spindle_torque.max() * job.spindle_speed)
    held = fastest_feed(job, 1.0, max_power=1.05 * power)
    assert held.limited_by == "power"
    assert held.best is not None and power < held.best.power <= 1.05 * power


@pytest.mark.slow
def test_an_override_along_the_path_is_faster_within_the_same_tolerance(job):
    tolerance = 1.3 * dm.simulate(job).contour.max
    one = fastest_feed(job, tolerance)
    found = fastest_feed(job, tolerance, knots=9)
    assert one.best is not None and found.best is not None
    assert found.along is not None and found.path is not None and one.along is None
    assert found.best.cycle_time < one.best.cycle_time
    assert found.along.min() >= one.best.override * (1 - 1e-9)
    assert found.along.max() <= 3.0 * (1 + 1e-9)
    again = dm.simulate(dataclasses.replace(job, path=found.path))
    np.testing.assert_allclose(again.contour.max, found.best.error, rtol=1e-6)
    assert again.contour.max <= tolerance
    # Its corners and ends are as slow as before: the gain is small here.
    assert one.path is not None and found.path.step_count < one.path.step_count


@pytest.mark.slow
def test_the_corrected_command_is_what_is_judged_and_returned(tmp_path):
    job = dm.load_job(write_slides_job(tmp_path, 'method = "mirror"')).with_precision()
    assert job.robot is not None
    robot = dataclasses.replace(job.robot, joint_speed=jnp.full(3, 10.0))
    job = dataclasses.replace(job, robot=robot)
    told = []
    found = fastest_feed(
        job,
        1.0,
        corrects=True,
        lowest=0.9,
        highest=0.9,
        on_progress=lambda message, share: told.append(message),
    )
    assert told[0] == "override 0.9" and "override 0.9: mirror" in told
    assert found.best is not None and found.path is not None
    assert found.commanded is not None
    own = dataclasses.replace(job, path=found.path)
    again = dm.simulate(own, commanded=found.commanded)
    np.testing.assert_allclose(again.contour.max, found.best.error, rtol=1e-6)
    # Slides move as the tip does.
    speed = lambda tips: np.abs(np.diff(tips, axis=0)).max() / job.tooth_period / 10
    desired = float(speed(np.asarray(found.path.positions)))
    assert found.best.joint_speed == pytest.approx(float(speed(found.commanded)))
    assert found.best.joint_speed > desired * (1 + 1e-6)


def test_what_has_no_fastest_feed_is_refused(job):
    with pytest.raises(ValueError, match="`knots` must be 0 or at least 2, but is 1"):
        fastest_feed(job, 1e-5, knots=1)
    with pytest.raises(ValueError, match="must have a soft machine"):
        fastest_feed(dataclasses.replace(job, robot=None), 1e-5)
    with pytest.raises(ValueError, match="`tolerance` must be positive"):
        fastest_feed(job, 0.0)
    with pytest.raises(ValueError, match="`max_power` must be positive"):
        fastest_feed(job, 1e-5, max_power=-1.0)
    with pytest.raises(ValueError, match="`highest` must not be below `lowest`"):
        fastest_feed(job, 1e-5, lowest=2.0, highest=1.0)
