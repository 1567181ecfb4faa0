"""Where the tool goes and how stiff it is there."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import diffmill.robot as dr


@pytest.fixture(scope="module")
def gantry():
    return dr.load("reis_rlp16_like")


def test_a_gantry_reaches_its_travels(gantry):
    # x 0 to 3 m, y +-0.8 m, z -1 to 0 m; at home (1.5, 0, -0.5) the tip is at 0.7 m.
    box = dr.StiffnessMap.reach_box(gantry)
    assert_allclose(box, [[0.0, -0.8, 0.2], [3.0, 0.8, 1.2]], atol=1e-9)


@pytest.mark.slow
def test_the_map_is_the_stiffness_where_the_tool_can_go(gantry):
    found = dr.StiffnessMap.around(gantry, gantry.home, plane="xz", count=13)
    across, up = np.meshgrid(found.across, found.up)
    slack = 1e-9
    inside = (across >= -slack) & (across <= 3 + slack)
    inside &= (up >= 0.2 - slack) & (up <= 1.2 + slack)
    assert 20 < inside.sum() < inside.size
    assert (np.isfinite(found.stiffness) == inside).all()
    # One of its points is the pose itself, and the ram bends more when it is out.
    row = int(np.argmin(np.abs(found.up - 0.7)))
    column = int(np.argmin(np.abs(found.across - 1.5)))
    here = dr.principal_stiffness(gantry, gantry.home)[0]
    assert_allclose(found.stiffness[row, column], here, rtol=1e-6)
    assert (np.diff(found.stiffness[inside[:, column], column]) > 0).all()


def test_a_plane_is_one_in_which_the_robot_moves():
    slide = dr.PrismaticJoint("x", (1.0, 0.0, 0.0), stiffness=1e6)
    body = dr.RigidBody(1.0, (0.0, 0.0, 0.0), np.eye(3))
    robot = dr.build([slide, body])
    with pytest.raises(ValueError, match="'yz'"):
        dr.StiffnessMap.around(robot, [0.0], plane="yz")
    with pytest.raises(ValueError, match="`count`"):
        dr.StiffnessMap.around(robot, [0.0], plane="xy", count=1)


def test_a_plane_has_two_axes(gantry):
    for plane in ("yy", "x", "xu"):
        with pytest.raises(ValueError, match="x, y, z"):
            dr.StiffnessMap.around(gantry, gantry.home, plane=plane)
