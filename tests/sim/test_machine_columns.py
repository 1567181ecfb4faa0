"""The band of expected error of machines with reversal, links, servos, a part."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from slides_job import ARM, ROBOT

import diffmill as dm
from diffmill.toolpath import contour_vector
from small_job import SLOT_STOCK, write_job

# Machines that differ from the model in nothing.
SAME: dict[str, Any] = dict.fromkeys(
    (
        *("stiffness", "damping", "force", "force_bias"),
        *("links", "link_angles", "backlash", "friction"),
    ),
    0.0,
)
# Mean and deviation of a half-normal error of size one.
MEAN, DEVIATION = np.sqrt(2 / np.pi), np.sqrt(1 - 2 / np.pi)
# A frame of lines along both axes.
FRAME = """G21 G17 G90 G94
G0 X-5.5 Y1 Z1
G0 Z-0.8
G1 X6 F3000
G1 Y7
G1 X-5.5
M2
"""
# With wrist and third axis damped so that it does not chatter.
MILLING_ARM = {
    "model": "kuka_kr210_like",
    "work_in_base": {"position": ["1800 mm", "0 mm", "900 mm"]},
    "joint_damping": [f"{D} N*m*s/rad" for D in (4706, 4481, 3000, 300, 300, 100)],
}


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    """A frame cut on three slides with servos."""
    folder = tmp_path_factory.mktemp("job")
    (folder / "arm.toml").write_text(ARM)
    changes = {
        "robot": ROBOT,
        "stock.lower": ["0 mm", "0 mm", "-2 mm"],
        "program.acceleration": "0.5 m/s^2",
        "program.smoothing": "40 ms",
        "simulation": {"substeps": 4},
        "controller": {"bandwidth": "15 Hz"},
    }
    file = write_job(folder, changes, program=FRAME)
    return dm.load_job(file).with_precision()


def scattered(job, **sizes):
    """Return the job with a scatter."""
    settings = dataclasses.replace(job.simulation, scatter=dm.ScatterSettings(**sizes))
    return dataclasses.replace(job, simulation=settings)


@pytest.fixture(scope="module")
def model(job):
    return dm.simulate(job)


def band_of(job, model, **sizes):
    return dm.sim.error_band(scattered(job, **sizes), model)


def vector(run):
    """Return the contour vectors of a run [m]."""
    tips = np.asarray(run.desired) + np.asarray(run.surface_deviation)
    return np.asarray(contour_vector(tips, np.asarray(run.desired)))


def drawn(job, **sizes):
    return dm.sim.drawn_machine(job, dm.TruthSettings(**(SAME | sizes)))


def assert_alike(model, found, wanted, share):
    """Compare changes where the tool cuts: no nearest point is at an end there."""
    cuts = np.asarray(model.is_cutting)
    size = np.sqrt(np.mean(wanted[cuts] ** 2))
    assert size > 1e-9
    assert np.sqrt(np.mean((found - wanted)[cuts] ** 2)) < share * size


def displacements(job, machine):
    moved = machine.robot.placement_positions - job.robot.placement_positions
    return np.ravel(moved)


def rotations(job, machine):
    R = np.asarray(job.robot.placement_rotations)
    turn = np.swapaxes(R, 1, 2) @ np.asarray(machine.robot.placement_rotations)
    return np.ravel([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], order="F")


def servos(job, machine):
    return np.log(np.asarray(machine.controller.bandwidth) / job.controller.bandwidth)


def part_shifts(job, machine):
    known = dm.sim.mismatched(job, job).nominal
    assert known is not None
    return np.asarray(known.probes - machine.nominal.probes).mean(0)


# Sizes of errors, the beginning of their names, and what they are of a drawn machine.
# Loads on joints that are turned are left out, which shows here along z.
SIGNED = {
    "link_angles": (1e-3, "link angle", rotations, 0.25),
    "bandwidth": (0.02, "bandwidth", servos, 0.03),
    "registration": (1e-6, "part", part_shifts, 0.03),
}


@pytest.mark.slow
def test_columns_are_differences_of_runs(job, model):
    sizes = {kind: size for kind, (size, *_) in SIGNED.items()}
    band = band_of(job, model, **sizes)
    for kind, (size, start, errors, share) in SIGNED.items():
        machine = drawn(job, **{kind: size})
        change = vector(dm.simulate(machine)) - vector(model)
        is_kind = [name.startswith(start) for name in band.names]
        x = errors(job, machine) / size
        found = np.einsum("p,pka->ka", x, band.shift[is_kind])
        assert_alike(model, found, change, share)


@pytest.mark.slow
def test_a_slide_that_is_displaced_is_touched_off(job, model):
    band = band_of(job, model, links=1e-3)
    machine = drawn(job, links=1e-3)
    assert np.abs(displacements(job, machine)).max() > 1e-4
    np.testing.assert_allclose(vector(dm.simulate(machine)), vector(model), atol=1e-8)
    assert np.abs(band.shift).max() < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "size", "share"), [("friction", 2e-5, 0.15), ("backlash", 2e-5, 0.2)]
)
def test_columns_of_reversal_are_differences_about_the_mean(
    job, model, kind, size, share
):
    band = band_of(job, model, **{kind: size})
    step = 0.1
    less, mean, more = (
        dm.simulate(drawn(job, **{kind: factor * MEAN * size}))
        for factor in (1 - step, 1.0, 1 + step)
    )
    np.testing.assert_allclose(band.contour_error, mean.contour_error, atol=1e-9)
    each = np.sum(band.shift, axis=0) / DEVIATION
    change = vector(more) - vector(less)
    assert_alike(model, 2 * step * MEAN * each, change, share)


@pytest.mark.slow
def test_the_column_of_run_out_is_a_difference(job, model):
    size, step = 1e-5, 0.1
    band = band_of(job, model, runout=size)
    assert band.names == ("runout",)
    less, more = (
        dm.simulate(drawn(job, runout=factor * MEAN * size))
        for factor in (1 - step, 1 + step)
    )
    change = vector(more) - vector(less)
    found = 2 * step * MEAN / DEVIATION * band.shift[0]
    # Some nanometres: teeth that take more and less make up for each other.
    assert_alike(model, found, change, 0.45)


def test_a_scatter_of_joints_needs_a_robot_that_swings(job, model):
    settings = dataclasses.replace(
        job.simulation, mode="quasistatic", scatter=dm.ScatterSettings(links=1e-4)
    )
    slow = dataclasses.replace(job, simulation=settings)
    with pytest.raises(ValueError, match="swings for a scatter of links"):
        dm.sim.error_band(slow, model)


ALL: dict[str, Any] = {
    "stiffness": 0.1,
    "damping": 0.2,
    "force": 0.1,
    "links": 2e-4,
    "link_angles": 2e-4,
    "backlash": 2e-5,
    "friction": 2e-5,
    "registration": 5e-6,
    "registration_angles": 1e-4,
}


@pytest.mark.slow
def test_the_band_covers_drawn_machines(tmp_path):
    """Of machines that are drawn 95 % lie within 1.96 standard deviations."""
    changes = {
        **SLOT_STOCK,
        "robot": MILLING_ARM,
        "program.acceleration": "0.5 m/s^2",
        "program.smoothing": "100 ms",
        "correction": {},
    }
    job = dm.load_job(write_job(tmp_path, changes)).with_precision()
    band = band_of(job, dm.simulate(job), **ALL)
    sizes = dm.UncertaintySettings(**ALL, is_gaussian=True, seed=5)
    runs = [dm.simulate(dm.sim.drawn_machine(job, sizes, k)) for k in range(40)]
    cuts = np.asarray(band.is_cutting)
    rms = np.sqrt(np.mean([run.contour.rms**2 for run in runs]))
    assert rms == pytest.approx(band.rms, rel=0.05)
    each = np.stack([vector(run)[cuts] for run in runs])
    away = each - each.mean(0)
    sigma = np.sqrt(np.sum(band.shift[:, cuts] ** 2, axis=0))
    # Across the slot.
    inside = np.abs(away[..., 1:]) <= 1.96 * sigma[None, :, 1:]
    assert 0.9 < inside.mean() < 0.99
