"""A real robot's published data against an independent program's answers."""

import json
import os
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import diffmill.robot as dr

ROOT = Path(__file__).parents[2]
DATA = Path(os.environ.get("DIFFMILL_REFERENCE_DATA", ROOT / "../shared/data"))
NAME = "kuka_kr210_r2700_2"

pytestmark = pytest.mark.skipif(
    not (DATA / "robots").is_dir(), reason="reference data are absent"
)


def find(node: ET.Element, path: str) -> ET.Element:
    """Return what is there by all rights."""
    found = node.find(path)
    assert found is not None, path
    return found


def numbers(node: ET.Element, key: str) -> list[float]:
    return [float(word) for word in node.attrib[key].split()]


def turned_inertia(node: ET.Element, rpy: list[float]) -> np.ndarray:
    """Return an inertia in the axes of its link."""
    xx, yy, zz, xy, xz, yz = (
        float(node.attrib[f"i{key}"]) for key in ("xx", "yy", "zz", "xy", "xz", "yz")
    )
    R = dr.rpy_matrix(*rpy)
    turned = R @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ R.T
    return (turned + turned.T) / 2


def chain(stiffness, name=NAME):
    """Return the robot of the description as elements (a serial chain only)."""
    root = ET.parse(DATA / "robots" / "industrial" / f"{name}.urdf").getroot()
    links = {link.get("name"): link for link in root.findall("link")}
    elements = []
    for k, K in enumerate(stiffness, start=1):
        joint = find(root, f"joint[@name='joint_{k}']")
        place = find(joint, "origin")
        inertial = find(links[find(joint, "child").attrib["link"]], "inertial")
        center = find(inertial, "origin")
        elements += [
            dr.FixedTranslation(numbers(place, "xyz")),
            dr.FixedRotation(dr.rpy_matrix(*numbers(place, "rpy"))),
            dr.RevoluteJoint(
                f"joint_{k}", numbers(find(joint, "axis"), "xyz"), stiffness=K
            ),
            dr.RigidBody(
                float(find(inertial, "mass").attrib["value"]),
                numbers(center, "xyz"),
                turned_inertia(find(inertial, "inertia"), numbers(center, "rpy")),
            ),
        ]
    flange = find(root, "joint[@name='link6-tool0']/origin")
    tool = dr.Tool(
        "tool0", numbers(flange, "xyz"), dr.rpy_matrix(*numbers(flange, "rpy"))
    )
    return dr.build([*elements, tool], name=name)


def test_dynamics_agree_with_pinocchio():
    file = DATA / "robots" / "expected_dynamics.json"
    case = json.loads(file.read_text())["models"][f"industrial/{NAME}.urdf"]
    robot = chain(np.ones(6))
    q, v, a = case["q"], case["v"], case["a"]
    assert_allclose(dr.mass_matrix(robot, q), case["M"], rtol=1e-10, atol=1e-10)
    assert_allclose(
        dr.ArmTerms.of_state(robot, q, v).bias_forces, case["nle"], rtol=1e-9, atol=1e-9
    )
    assert_allclose(
        dr.gravity_forces(robot, q), case["gravity_torque"], rtol=1e-9, atol=1e-9
    )
    tau = dr.inverse_dynamics(robot, q, v, a)
    assert_allclose(tau, case["rnea_tau"], rtol=1e-9, atol=1e-9)


def test_compliance_and_modes_agree_with_pinocchio_and_scipy():
    file = DATA / "robots" / "expected_compliance.json"
    cases = json.loads(file.read_text())["cases"]
    checked = [case for key, case in cases.items() if key.startswith(NAME)]
    assert checked
    for case in checked:
        robot = chain(case["K"])
        q = np.radians(case["q_deg"])
        T = dr.forward_kinematics(robot, q)
        assert_allclose(T[:3, 3], case["tcp"], atol=1e-12)
        assert_allclose(dr.jacobian(robot, q), case["J"], atol=1e-12)
        C = dr.cartesian_compliance(robot, q)
        assert_allclose(C, case["C6_m_rad_per_N_Nm"], rtol=1e-9, atol=1e-18)
        found = dr.natural_frequencies(robot, q)
        assert_allclose(found, case["natural_freq_hz"], rtol=1e-9)


def at_flange(name: str) -> dr.Robot:
    """Return a built-in model with its tip at the flange, as the data have it."""
    return dr.load(name).with_tool(np.eye(4))


def test_the_built_in_kr210_bends_as_computed_elsewhere():
    file = DATA / "robots" / "expected_compliance.json"
    cases = json.loads(file.read_text())["cases"]
    robot = at_flange("kuka_kr210_like")
    for case in cases.values():
        q = np.radians(case["q_deg"])
        assert_allclose(dr.forward_kinematics(robot, q)[:3, 3], case["tcp"], atol=1e-9)
        stiffness = 1e-6 * np.asarray(dr.principal_stiffness(robot, q))
        assert_allclose(stiffness, case["cartesian_stiffness_N_per_um_eig"], rtol=1e-3)
        for axis, expected in enumerate(case["disp_mm_per_100N"].values()):
            wrench = np.eye(6)[axis] * 100.0
            found = 1e3 * np.asarray(dr.static_deflection(robot, q, wrench)[:3])
            error = np.linalg.norm(found - expected) / np.linalg.norm(expected)
            assert error < 0.01


@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("kuka_kr210_like", "kuka_kr210_r2700_2"),
        ("kuka_kr10_like", "kuka_kr10_r1100_2"),
    ],
)
def test_built_in_arms_have_the_links_of_their_source(name, file):
    # All but the last link, which carries the spindle in the model.
    made, source = dr.load(name), chain(np.ones(6), file)
    assert_allclose(made.link_masses[:5], source.link_masses[:5], rtol=1e-5)
    assert_allclose(made.link_centers[:5], source.link_centers[:5], atol=1e-6)
    inertias = np.asarray(source.link_inertias[:5])
    error = np.abs(np.asarray(made.link_inertias[:5]) - inertias)
    assert (error <= 1e-5 * inertias.max(axis=(1, 2), keepdims=True)).all()
    q = np.array([0.3, -1.2, 1.4, 0.2, 0.7, -0.4])
    flange = dr.forward_kinematics(at_flange(name), q)
    assert_allclose(flange, dr.forward_kinematics(source, q), atol=1e-9)
    at = lambda key: next(
        float(find(joint, "limit").attrib[key])
        for joint in ET.parse(DATA / "robots" / "industrial" / f"{file}.urdf")
        .getroot()
        .findall("joint[@name='joint_5']")
    )
    assert_allclose(made.joint_lower[4], at("lower"), rtol=1e-3)
    assert_allclose(made.joint_upper[4], at("upper"), rtol=1e-3)
