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
    ratios = np.asarray(dr.damping_ratios(arm, arm.home))
    assert_allclose(ratios[:3], 0.02, rtol=0.3)


def test_each_damper_is_two_percent_of_its_joint(arm):
    # What the file says of its dampers; the numbers there are rounded.
    M = np.asarray(dr.mass_matrix(arm, arm.home))
    critical = 2.0 * np.sqrt(np.diag(M) * np.asarray(arm.joint_stiffness))
    assert_allclose(arm.joint_damping / critical, 0.02, rtol=0.02)


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
