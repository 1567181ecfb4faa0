"""Robots of others, from their URDF, against independent programs and closed forms."""

import dataclasses
import json
import os
import re
import warnings
from pathlib import Path

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose

import diffmill.robot as dr

ROOT = Path(__file__).parents[2]
DATA = Path(os.environ.get("DIFFMILL_REFERENCE_DATA", ROOT / "../shared/data"))
ROBOTS = DATA / "robots"
EXPECTED = ROBOTS / "expected_dynamics.json"

pytestmark = pytest.mark.skipif(
    not EXPECTED.is_file(), reason="reference data are absent"
)


def cases():
    """Return the recorded answers of all robots with joints."""
    if not EXPECTED.is_file():
        return {}
    models = json.loads(EXPECTED.read_text())["models"]
    return {file: case for file, case in models.items() if case.get("n_joints")}


CASES = cases()
MASSLESS = {file for file, case in CASES.items() if case["M_min_eig"] == 0.0}
# Many joints take longest to compile.
LARGE = {
    "tree_prismatic/erd_tiago.urdf",
    "tree_prismatic/pinocchio_simple_humanoid.urdf",
}
EACH = [
    pytest.param(file, marks=pytest.mark.slow if file in LARGE else ())
    for file in sorted(CASES)
]


def read(path, **options):
    """Return a robot, whatever its file is warned of."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", dr.RobotFileWarning)
        return dr.load(path, **options)


@jax.jit
def all_quantities(robot, q, qd, qdd, tau, wrench):
    """Return everything in one program: it compiles once for robots of one build."""
    terms = dr.ArmTerms.of_state(robot, q, qd)
    return {
        "T": terms.T_base_tool,
        "J": terms.jacobian,
        "M": terms.mass_matrix,
        "bias": terms.bias_forces,
        "inverse": dr.inverse_dynamics(robot, q, qd, qdd, wrench),
        "forward": dr.forward_dynamics(robot, q, qd, tau, wrench),
    }


def answers(robot, *state):
    """Return `all_quantities`, whatever robot and joints are called."""
    names = tuple(map(str, range(robot.joint_count)))
    return all_quantities(
        dataclasses.replace(robot, name="", joint_names=names), *state
    )


def assert_close(found, expected, what):
    """Compare to 1e-9 of the largest entry."""
    scale = np.max(np.abs(expected), initial=1e-300)
    assert_allclose(found, expected, rtol=0, atol=1e-9 * scale, err_msg=what)


@pytest.mark.parametrize("file", EACH)
def test_recorded_answers(file, tmp_path):
    case = CASES[file]
    # Recorded with every joint on its own.
    text = re.sub(r"<mimic[^>]*/>", "", (ROBOTS / file).read_text())
    (tmp_path / "free.urdf").write_text(text)
    robot = read(tmp_path / "free.urdf", tool=case["end_body"])
    assert sorted(robot.joint_names) == sorted(case["joint_names"])
    order = [case["joint_names"].index(name) for name in robot.joint_names]
    q, qd, qdd = (np.array(case[key])[order] for key in "qva")
    found = answers(robot, q, qd, qdd, np.zeros(len(q)), np.zeros(6))
    assert_close(found["T"][:3, 3], case["end_pos"], "position")
    assert_close(found["T"][:3, :3], case["end_rot"], "rotation")
    J = np.array(case["J_local_world_aligned_lin_ang"])[:, order]
    assert_close(found["J"], J, "Jacobian")
    if file in MASSLESS:
        assert not np.any(found["M"])
        assert np.isnan(found["forward"]).all()
        return
    assert_close(found["M"], np.array(case["M"])[np.ix_(order, order)], "M")
    assert_close(found["bias"], np.array(case["nle"])[order], "bias")
    assert_close(found["inverse"], np.array(case["rnea_tau"])[order], "inverse")


@pytest.mark.parametrize("file", EACH)
def test_random_states_against_pinocchio(file, rng):
    pin = pytest.importorskip("pinocchio")
    model = pin.buildModelFromUrdf(str(ROBOTS / file))
    tool = CASES[file]["end_body"]
    frame = model.getFrameId(tool)
    robot = read(ROBOTS / file, tool=tool)
    names = list(model.names)[1:]
    free = [name for name in names if name in robot.joint_names]
    assert tuple(free) == robot.joint_names, "joint vectors are interchangeable"
    G, offset = follow(ROBOTS / file, names, robot.joint_names)
    data = model.createData()
    for _ in range(3):
        q, v, a, tau = rng.normal(size=(4, robot.joint_count))
        wrench = 50.0 * rng.normal(size=6)
        found = answers(robot, q, v, a, tau, wrench)
        # A continuous joint is a point on the circle there.
        x = pin.integrate(model, pin.neutral(model), G @ q + offset)
        pin.framesForwardKinematics(model, data, x)
        assert_close(found["T"], data.oMf[frame].homogeneous, "pose")
        J = pin.computeFrameJacobian(model, data, x, frame, pin.LOCAL_WORLD_ALIGNED)
        assert_close(found["J"], J @ G, "Jacobian")
        M = pin.crba(model, data, x)
        M = G.T @ (np.triu(M) + np.triu(M, 1).T) @ G
        assert_close(found["M"], M, "M")
        bias = G.T @ pin.nonLinearEffects(model, data, x, G @ v)
        assert_close(found["bias"], bias, "bias")
        load = J.T @ wrench
        inverse = G.T @ (pin.rnea(model, data, x, G @ v, G @ a) - load)
        assert_close(found["inverse"], inverse, "inverse")
        if file in MASSLESS:
            continue
        if robot.has_mimics:
            forward = np.linalg.solve(M, tau + G.T @ load - bias)
        else:
            forward = pin.aba(model, data, x, v, tau + load)
        assert_close(found["forward"], forward, "forward")


def follow(file, names, independent):
    """Return all joints as G q + offset, from the text of the file."""
    G, offset = np.zeros((len(names), len(independent))), np.zeros(len(names))
    for row, name in enumerate(names):
        (joint,) = re.findall(rf'<joint name="{name}" type.*?</joint>', text_of(file))
        mimic = re.search(r"<mimic([^>]*)/>", joint)
        attributes = dict(re.findall(r'(\w+)="([^"]*)"', mimic[1])) if mimic else {}
        source = attributes.get("joint", name)
        G[row, independent.index(source)] = float(attributes.get("multiplier", 1))
        offset[row] = float(attributes.get("offset", 0))
    return G, offset


def text_of(file):
    return " ".join(file.read_text().split())


def test_quirky_files_have_their_outcome():
    loads = {"drake_acrobot.urdf", "pinocchio_3DOF_planar.urdf"}
    for path in sorted((ROBOTS / "quirky").iterdir()):
        if path.suffix not in (".urdf", ".xml"):
            continue
        if path.name in loads:
            assert read(path).joint_count > 0
            continue
        with pytest.raises(dr.RobotFileError) as caught:
            read(path)
        assert path.name in str(caught.value)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("urdfdom_bad_vector_word", "xyz must be 3 finite numbers, but is '1.0 foo 3"),
        ("urdfdom_bad_vector_short", "xyz must be 3 finite numbers, but is '1.0 2.0'"),
        ("urdfdom_version_foo", "version must be 1.0, 1.1 or 1.2, but is 'foo'"),
        ("urdfdom_version_1_0", "no movable joint"),
        ("drake_zero_dof_robot", "no movable joint"),
        ("urdfdom_parse_joint_doubles", "link 'l2' hangs on several joints: j1, j2"),
    ],
)
def test_quirky_files_are_refused_for_what_they_are(name, message):
    with pytest.raises(dr.RobotFileError, match=message):
        dr.load(ROBOTS / "quirky" / f"{name}.urdf")


def test_the_acrobot_of_drake_has_its_closed_form():
    robot = dr.load(ROBOTS / "quirky" / "drake_acrobot.urdf")
    assert robot.joint_names == ("ShoulderJoint", "ElbowJoint")
    q1, q2 = q = np.array([0.4, -1.1])
    M11, M12, M22 = 2.663 + 2 * np.cos(q2), 1.33 + np.cos(q2), 1.33
    assert_allclose(dr.mass_matrix(robot, q), [[M11, M12], [M12, M22]], rtol=1e-12)
    elbow = 9.81 * np.sin(q1 + q2)
    gravity = [9.81 * 1.5 * np.sin(q1) + elbow, elbow]
    assert_allclose(dr.gravity_forces(robot, q), gravity, rtol=1e-12)


def test_placeholders_are_warned_of():
    file = ROBOTS / "industrial" / "ros_industrial_kr120r2500pro_dummy_inertia.urdf"
    with pytest.warns(dr.RobotFileWarning, match="the same: placeholders"):
        dr.load(file, tool="tool0")


def test_a_robot_without_mass_is_for_kinematics_only():
    file = ROBOTS / "quirky" / "pinocchio_3DOF_planar.urdf"
    with pytest.warns(dr.RobotFileWarning, match="kinematics only.* pz, py, px"):
        robot = dr.load(file)
    q = np.array([0.1, 0.2, 0.3])
    assert_allclose(dr.forward_kinematics(robot, q)[:3, 3], q[::-1], rtol=1e-15)
    with pytest.raises(ValueError):
        dr.forward_dynamics(robot, q, q, q)
