"""The tables of springs behind the arm."""

import math

import numpy as np
import pytest

from diffmill import load_job
from diffmill.robot import FlangeSpring, cartesian_compliance, load
from small_job import FLANGE_SPRING, problems_of

TOOL = """
[robot.bending_tool]
overhang = "40 mm"
young_modulus = "580 GPa"
damping_ratio = 0.03
flute_share = 1
"""
SPINDLE = FlangeSpring(
    30.0, (0.0, 0.0, 0.17), (0.75, 0.75, 0.2), rotary_stiffness=(2e6, 3e6, 4e6)
)


def test_both_tables_make_a_robot_in_series(write):
    job = load_job(write(FLANGE_SPRING + TOOL))
    robot = job.robot
    assert robot is not None
    names = ("flange_rx", "flange_ry", "flange_rz", "tool_x", "tool_y")
    assert robot.joint_names[6:] == names
    C = np.asarray(cartesian_compliance(robot, robot.home))
    only = SPINDLE.mounted_on(load("reis_rv130_like"))
    more = np.trace(C[:3, :3]) - np.trace(
        np.asarray(cartesian_compliance(only, only.home))[:3, :3]
    )
    D = 2 * job.cutter.nominal_radius
    bend = 40e-3**3 / (3 * 580e9 * math.pi * D**4 / 64)
    np.testing.assert_allclose(more, 2 * bend, rtol=1e-6)


@pytest.mark.parametrize(
    ("more", "parts"),
    [
        ('[robot.bending_tool]\noverhang = "0 mm"', ("bending_tool.overhang", "0 mm")),
        ("[robot.bending_tool]", ("bending_tool.overhang", "required", "40 mm")),
        (TOOL.replace("0.03", "3"), ("bending_tool.damping_ratio", "3", "from 0 to 1")),
        (TOOL.replace("GPa", "mm"), ("bending_tool.young_modulus", "600 GPa")),
        (
            FLANGE_SPRING.replace("30 kg", "99 kg"),
            ("flange_spring", "at most", "36.6 kg"),
        ),
        (
            FLANGE_SPRING.replace("rotary_stiffness", "stiffness"),
            ("flange_spring.stiffness", "unknown key", "rotary_stiffness"),
        ),
    ],
)
def test_faults_of_the_tables(write, more, parts):
    (problem,) = problems_of(write(more))
    for part in ("[robot", *parts):
        assert part in problem
