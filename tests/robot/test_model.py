"""What the built-in arm promises: figures, freedom, sources."""

import tomllib
from importlib import resources

import numpy as np
import pytest
from numpy.testing import assert_allclose

import diffmill.robot as dr


def test_the_spindle_points_down_in_front_of_the_arm(arm):
    T = np.asarray(dr.forward_kinematics(arm, arm.home))
    assert_allclose(T[:3, :3], np.eye(3), atol=1e-12)
    assert 1.2 < T[0, 3] < 2.0 and abs(T[1, 3]) < 1e-9 and 0.8 < T[2, 3] < 1.0
    assert np.linalg.cond(dr.jacobian(arm, arm.home)) < 10


def test_it_is_as_soft_as_was_measured(arm):
    # About 0.25 mm at 100 N (Abele et al. 2008): the softer horizontal direction.
    C = np.asarray(dr.cartesian_compliance(arm, arm.home))[:3, :3]
    horizontal = np.linalg.eigvalsh(C[:2, :2]) * 100.0 * 1e3
    assert 0.23 < horizontal[-1] < 0.27
    assert horizontal[0] > 0.15
    # And with gravity and all, by the loaded balance.
    theta = dr.motor_positions(arm, arm.home)
    pushed = dr.loaded_equilibrium(arm, theta, np.array([0, 100.0, 0, 0, 0, 0]))
    moved = dr.forward_kinematics(arm, pushed) - dr.forward_kinematics(arm, arm.home)
    assert_allclose(moved[1, 3] * 1e3, 0.25, rtol=0.08)


def test_it_rings_as_milling_robots_do(arm):
    frequencies = np.asarray(dr.natural_frequencies(arm, arm.home))
    assert 7.0 < frequencies[0] < 15.0
    ratios = np.asarray(dr.mode_shapes(arm, arm.home).damping_ratios)
    assert_allclose(ratios[:3], 0.02, rtol=0.3)


@pytest.mark.parametrize("corner", list(np.ndindex(2, 2, 2)))
def test_it_moves_freely_around_home(arm, corner):
    T = np.asarray(dr.forward_kinematics(arm, arm.home)).copy()
    T[:3, 3] += 0.6 * np.array(corner) - 0.3
    found = dr.inverse_kinematics(arm, T, arm.home)
    assert bool(found.converged) and bool(found.within_limits)
    assert np.linalg.cond(dr.jacobian(arm, found.q)) < 10


def test_every_number_of_the_models_names_its_source():
    for name in dr.built_in_models():
        file = resources.files("diffmill.robot").joinpath("models", f"{name}.toml")
        elements = tomllib.loads(file.read_text(encoding="utf-8"))["elements"]
        assert len(elements) > 6
        for element in elements:
            numbers = set(element) - {"kind", "name", "source", "virtual"}
            assert numbers == set(element["source"]), element
            assert all(text for text in element["source"].values())


@pytest.fixture(scope="module")
def models():
    """All built-in models by name."""
    return {name: dr.load(name) for name in dr.built_in_models()}


def test_the_models_are_there(models):
    wanted = {"kuka_kr10_like", "kuka_kr210_like", "reis_rlp16_like", "reis_rv130_like"}
    assert set(models) == wanted
    for robot in models.values():
        # Spindle down, axes of the tool along those of the base.
        T = np.asarray(dr.forward_kinematics(robot, robot.home))
        assert_allclose(T[:3, :3], np.eye(3), atol=1e-9)
        assert np.isfinite(robot.joint_stiffness).all()


@pytest.mark.parametrize(
    ("name", "softest", "stiffest", "first_mode"),
    [
        # Published for robots of the class: 0.5 to 0.8 and 3 to 5 N/um, 9 to 12 Hz.
        ("kuka_kr210_like", (0.5, 1.0), (2.0, 6.0), (9.0, 13.0)),
        # Measured on a KR 10: 0.08 to 0.11 horizontally, 0.15 to 0.20 vertically.
        ("kuka_kr10_like", (0.07, 0.15), (0.15, 0.4), (10.0, 25.0)),
        # Assumed; a gantry is stiffer than an arm, and rings faster.
        ("reis_rlp16_like", (2.0, 10.0), (10.0, 60.0), (20.0, 60.0)),
    ],
)
def test_stiffness_and_first_mode_are_those_of_the_class(
    models, name, softest, stiffest, first_mode
):
    robot = models[name]
    found = 1e-6 * np.asarray(dr.principal_stiffness(robot, robot.home))
    assert softest[0] < found[0] < softest[1]
    assert stiffest[0] < found[2] < stiffest[1]
    slowest = dr.natural_frequencies(robot, robot.home)[0]
    assert first_mode[0] < slowest < first_mode[1]


@pytest.mark.parametrize(
    ("name", "rounding"),
    [("kuka_kr10_like", 0.025), ("reis_rlp16_like", 0.025), ("reis_rv130_like", 0.02)],
)
def test_assumed_dampers_are_two_percent_of_their_joints(models, name, rounding):
    """What the files say of them; the numbers there are rounded."""
    robot = models[name]
    M = np.diag(np.asarray(dr.mass_matrix(robot, robot.home)))
    critical = 2.0 * np.sqrt(M * np.asarray(robot.joint_stiffness))
    assert_allclose(robot.joint_damping / critical, 0.02, rtol=rounding)


def test_the_gantry_is_softer_with_its_ram_out(models):
    robot = models["reis_rlp16_like"]
    z = robot.joint_names.index("axis_z")
    stiffness = [
        dr.principal_stiffness(robot, robot.home.at[z].set(out))[0]
        for out in (0.0, -0.5, -1.0)
    ]
    assert stiffness[0] > stiffness[1] > stiffness[2]
    # And its tip goes where the axes go.
    q = robot.home + np.array([0.1, -0.2, 0.0, 0.0, 0.3])
    moved = dr.forward_kinematics(robot, q) - dr.forward_kinematics(robot, robot.home)
    assert_allclose(moved[:3, 3], [0.1, -0.2, 0.3], atol=1e-12)
