"""Sensitivity maps against differences and against what a spring does."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import PAPER_LAW, cut_rms

from diffmill import (
    ScatterSettings,
    cutter as ct,
    cutting,
    process as pr,
    sim,
    simulate,
    toolpath as tp,
    workpiece as wp,
)
from diffmill.correction import Ensemble
from machines import MASS, STIFFNESS, job_of, slides

PERIOD = 3.75e-3
COUNT = 40


@pytest.fixture(scope="module")
def job():
    tips = np.tile([-5.5e-3, 4e-3, -1e-3], (COUNT, 1))
    tips[:, 0] += 0.3e-3 * np.arange(COUNT)
    path = tp.Path.upright(PERIOD * np.arange(COUNT), tips)
    stock = wp.box([0, 0, -2e-3], [10e-3, 8e-3, 0], 0.5e-3)
    return job_of(slides(), path, stock, angles=192, substeps=2, mode="quasistatic")


@pytest.fixture(scope="module")
def maps(job):
    return sim.sensitivity(job)


@pytest.mark.slow
def test_every_parameter_has_a_row(maps):
    drives = ("K x", "K y", "K z", "D x", "D y", "D z")
    assert maps.names[:6] == drives
    assert {"K_tc", "K_rc", "K_ac", "speed"} <= set(maps.names)
    data = maps.to_dataset()
    assert data["sensitivity_deviation"].shape == (len(maps.names), COUNT, 3)
    assert data["sensitivity_contour_error"].attrs["units"] == "m"
    assert data["sensitivity_contour_vector"].dims == ("parameter", "step", "axis")


@pytest.mark.slow
def test_before_the_cut_nothing_moves_the_tool(maps):
    """Of each stiffness its own sag is lifted, as by who probes the work."""
    np.testing.assert_allclose(maps.deviation[:, 0], 0.0, atol=1e-12)


@pytest.mark.slow
def test_the_contour_vector_moves_across_the_path(maps):
    """The slot runs along x: only y and z are errors of its contour."""
    across, size = maps.contour_vector[..., 1:], np.abs(maps.deviation).max()
    # The first and the last row may lie beyond the ends of the path.
    np.testing.assert_allclose(maps.contour_vector[:, 1:-1, 0], 0.0, atol=1e-9 * size)
    assert np.abs(across[maps.names.index("K y")]).max() > 1e-7
    length = np.linalg.norm(maps.contour_vector, axis=2)
    assert (np.abs(maps.contour_error) <= length * (1 + 1e-9) + 1e-15).all()


@pytest.mark.slow
def test_maps_agree_with_differences(job, maps):
    job = job.with_precision()
    joints, _ = sim.JobKinematics(job).joints(jnp.asarray(job.path.positions))

    @jax.jit
    def tip(log_scale):
        scaled = job.with_scaled(log_scale)
        motors = sim.JobKinematics(scaled).motor_positions_from_joints(joints)
        return sim.MachiningProblem.of(scaled, pr.ThroughPoses()).run(motors).actual

    zero = np.zeros(len(maps.names))
    for name in ("K y", "K_tc", "K_rc"):
        k = maps.names.index(name)
        step = np.zeros_like(zero)
        # Smooth to 1e-4 relative; much smaller drowns in the rounding of the balance.
        step[k] = 1e-4
        ahead, behind = tip(jnp.asarray(step)), tip(jnp.asarray(-step))
        found = (np.asarray(ahead) - np.asarray(behind)) / 2e-4
        exact = maps.deviation[k]
        size = np.abs(exact).max()
        assert size > 1e-6
        # Chips that begin or end between the two have a kink there.
        error = np.abs(found - exact) / size
        assert np.quantile(error, 0.95) < 1e-3
        assert error.max() < 0.1


@pytest.mark.slow
def test_the_band_of_a_stiffness_adds_to_the_error(job):
    """Of slides the sag is the same everywhere: who probes the work does not see it."""
    settings = dataclasses.replace(
        job.simulation, mode="dynamic", scatter=ScatterSettings(stiffness=0.1)
    )
    job = dataclasses.replace(job, simulation=settings)
    solution = sim.simulate(job)
    band = sim.error_band(job, solution)
    assert band.names == ("K x", "K y", "K z")
    np.testing.assert_allclose(band.shift[:, 0], 0.0, atol=1e-15)
    sag = 9.81 * MASS / STIFFNESS[2]
    air = np.argmax(np.asarray(solution.is_cutting)) - 1
    assert air > 0 and np.max(band.spread[:air]) < 1e-3 * sag
    error = np.asarray(solution.contour_error)
    np.testing.assert_allclose(band.expected**2, error**2 + band.spread**2)
    cutting = np.asarray(solution.is_cutting)
    assert band.rms == pytest.approx(np.sqrt(np.mean(band.expected[cutting] ** 2)))
    data = band.to_dataset()
    assert data["contour_error_spread"].attrs["units"] == "m"

    softer = eqx.tree_at(
        lambda j: j.robot.joint_stiffness, job, job.robot.joint_stiffness * (1 - 1e-3)
    )
    # The controller goes on by the stiffness that it knows.
    assert solution.motor_positions is not None
    ran = sim.MachiningProblem.of(softer, pr.FrozenStock()).run(
        solution.motor_positions
    )
    moved = np.asarray(ran.actual - solution.actual)
    moved = (moved - moved[0])[:, 2]
    known = np.sum(band.shift, axis=0)[:, 2]
    assert np.quantile(np.abs(known * -1e-2 - moved), 0.9) < 0.05 * np.abs(moved).max()


@pytest.mark.slow
def test_contours_are_those_of_the_side_where_material_stays(job):
    """Three teeth make the right wall half a period after the left one."""
    path = eqx.tree_at(lambda p: p.positions, job.path, np.array(job.path.positions))
    path.positions[:, 1] = 7e-3
    speed = 2 * math.pi / (3 * PERIOD)
    job = dataclasses.replace(
        job, path=path, cutter=ct.flat_end_mill(10e-3, 3), spindle_speed=speed
    )
    maps = sim.sensitivity(job)
    k, step = maps.names.index("K y"), 1e-4
    place = np.eye(len(maps.names))[k]
    ahead, behind = (
        sim.simulate(job.with_scaled(jnp.asarray(sign * step * place)))
        for sign in (1, -1)
    )
    walls = ahead.surface_deviation - behind.surface_deviation
    found = np.asarray(walls)[:, 1] / (2 * step)
    error = np.abs(found - maps.contour_vector[k][:, 1]) / np.abs(found).max()
    assert np.quantile(error, 0.9) < 2e-3


def test_of_a_force_its_coefficients_scatter_and_nothing_else(job):
    law = cutting.KienzleLaw(1e9, 4e8, 1e8, 0.25, 0.3, 0.2, K_te=1e4)
    bottom = cutting.LinearEdgeLaw(5e8, 3e8, 0.0)
    job = dataclasses.replace(job, law=law, bottom_law=bottom)
    names = job.parameter_names
    assert not {"reference_thickness", "least_thickness"} & set(names)
    draws = Ensemble.draw_scales(names, count=3, seed=1, force=0.1)
    moved = {name for name, x in zip(names, draws.T, strict=True) if np.any(x != 0)}
    assert moved == {"K_tc11", "K_rc11", "K_ac11", "K_te", "K_re", "K_ae"}
    scale = np.log(2.0) * (np.array(names) == "K_te")
    scaled = job.with_scaled(jnp.asarray(scale))
    assert float(scaled.law.K_te) == pytest.approx(2e4)
    linear = dataclasses.replace(job, law=PAPER_LAW)
    names = np.array(linear.parameter_names)
    scaled = linear.with_scaled(jnp.asarray(np.log(2.0) * (names == "K_tc")))
    assert float(scaled.bottom_law.K_tc) == pytest.approx(1e9)
    assert float(scaled.law.K_tc) == pytest.approx(2 * float(PAPER_LAW.K_tc))


def test_scaling_reaches_every_parameter_and_no_other(job):
    names = job.parameter_names
    scaled = job.with_scaled(jnp.log(2.0 + jnp.arange(1.0 * len(names))))
    assert scaled.robot is not None and job.robot is not None
    np.testing.assert_allclose(scaled.robot.joint_stiffness / STIFFNESS, [2, 3, 4])
    ratio = np.asarray(scaled.robot.joint_damping / job.robot.joint_damping)
    np.testing.assert_allclose(ratio, [5, 6, 7])
    for k, name in enumerate(names[6:-1], start=8):
        found, known = (float(getattr(j.law, name)) for j in (scaled, job))
        assert found == pytest.approx(k * known)
    assert float(scaled.spindle_speed) == pytest.approx(
        (1 + len(names)) * job.spindle_speed
    )
    same = job.with_scaled(jnp.zeros(len(names)))
    assert jax.tree.all(
        jax.tree.map(
            lambda a, b: bool(np.all(np.asarray(a) == np.asarray(b))), same, job
        )
    )


@pytest.mark.slow
def test_a_mismatch_is_the_run_of_a_scaled_job(job):
    solution = simulate(job)
    found = {x.kind: x for x in sim.mismatch(job, solution, 0.2)}
    others = {"stiffness": ("K x", "K y", "K z"), "force": PAPER_LAW.parameter_names}
    for kind, names in others.items():
        is_off = np.isin(job.parameter_names, names)
        for factor, left in ((0.8, found[kind].less), (1.2, found[kind].more)):
            scale = np.where(is_off, math.log(factor), 0.0)
            run = simulate(job.with_precision().with_scaled(jnp.asarray(scale)))
            assert left == pytest.approx(cut_rms(run), rel=1e-9)
    # A softer slide is pushed away in proportion, and pushed back a little less.
    asis = cut_rms(solution)
    assert found["stiffness"].less / asis == pytest.approx(1 / 0.8, rel=0.05)
    assert found["force"].more / asis == pytest.approx(1.2, rel=0.05)
    assert found["force"].worse == found["force"].more
    with pytest.raises(ValueError, match="share"):
        sim.mismatch(job, solution, 1.0)
