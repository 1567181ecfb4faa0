"""Checks before a program is loaded: by hand, from a dataset that is made up."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
import xarray

from diffmill.robot import PrismaticJoint, RevoluteJoint, RigidBody, Tool, build
from diffmill.viz import write_report

from .test_report import read

BOX = "Before you load it"


@pytest.fixture
def arm_job(job):
    """The job on a turning and a sliding joint with limits and largest speeds."""
    elements = [
        RevoluteJoint("turn", (0, 0, 1), lower=-1.0, upper=1.0, speed=2.0),
        PrismaticJoint("slide", (1, 0, 0), lower=-0.5, upper=0.5, speed=0.1),
        RigidBody(1.0, (0.0, 0.0, 0.0), np.eye(3)),
        Tool("tool"),
    ]
    return dataclasses.replace(job, robot=build(elements), modes=None)


def table(tmp_path, dataset, job):
    """Rows of the box as text."""
    path = write_report(tmp_path, dataset, {}, job=job)
    text = read(path).text
    # Its title stands in the contents, too.
    return text.split(BOX)[2].split("On the machine")[0]


def with_motors(dataset, motors):
    dims = ("case", "step", "joint")
    whole = np.broadcast_to(motors, (dataset.sizes["case"], *motors.shape))
    return dataset.assign(motor_positions=xarray.DataArray(whole, dims=dims))


def test_limits_and_speeds_of_joints_are_named(correction, arm_job, tmp_path):
    count, step = correction.sizes["step"], float(correction["time"][1])
    motors = np.zeros((count, 2))
    motors[7, 0], motors[20:, 1] = 0.98, 0.05 * step * np.arange(count - 20)
    motors[20:, 1] = np.minimum(motors[20:, 1], 0.2)
    text = table(tmp_path, with_motors(correction, motors), arm_job)
    # 0.02 rad are 1.15 deg; 0.98 rad in a step are far above 2 rad/s.
    assert "turn comes closest, to 1.15 deg of its limit" in text
    assert "\u2610 joint limits" in text and "\u2717 joint speeds" in text
    motors[7, 0] = 0.0
    text = table(tmp_path, with_motors(correction, motors), arm_job)
    assert "\u2713 joint limits" in text
    assert "slide moves with 50 % of its largest speed" in text
    assert "\u2713 joint speeds" in text
    robot = dataclasses.replace(arm_job.robot, joint_speed=jnp.full(2, jnp.inf))
    free = dataclasses.replace(arm_job, robot=robot)
    text = table(tmp_path, with_motors(correction, motors), free)
    assert "joint speeds The robot's file states no limits" in text
    motors[7, 0] = 1.1
    assert "\u2717 joint limits" in table(
        tmp_path, with_motors(correction, motors), arm_job
    )


def test_chatter_and_warnings_stand_out(correction, job, tmp_path):
    calm = table(tmp_path, correction, job)
    assert "\u2713 chatter" in calm and "override" in calm
    told = correction.assign_attrs(
        stability_has_chatter=1, notes="warning: the cut is unstable\na plain note"
    )
    path = write_report(tmp_path, told, {}, job=job)
    text = read(path).text
    assert "\u2717 chatter" in text
    # Under the verdict, before the contents; notes come behind all.
    assert text.index("the cut is unstable") < text.index("Where the tool misses")
    assert text.index("a plain note") > text.index(BOX)
    off = dataclasses.replace(
        job, simulation=dataclasses.replace(job.simulation, stability="none")
    )
    assert "Not examined" in table(tmp_path, correction, off)


def test_sections_are_linked_and_long_ones_folded(correction, job, tmp_path):
    page = read(write_report(tmp_path, correction, {}, job=job))
    anchors = {a["id"] for tag, a in page.tags if tag == "section"}
    links = {a["href"] for tag, a in page.tags if tag == "a"}
    assert {f"#{name}" for name in anchors} == links and "result" in anchors
    assert sum(tag == "details" for tag, _ in page.tags) >= 1
