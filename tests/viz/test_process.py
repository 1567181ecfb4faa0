from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from helpers import PAPER_LAW

from diffmill.cutter import flat_end_mill
from diffmill.process import Process, choose_engagement
from diffmill.sim import Replay
from diffmill.viz import ForceTrace
from diffmill.workpiece import Pose, box

RADIUS, FEED, DEPTH = 2e-3, 0.05e-3, 0.8e-3


def process_of(half, helix=0.0, **sizes):
    """Return the process of a mill in a block of a half width [m]."""
    stock = box([-half, -half, -2e-3], [half, half, 0.0], 0.2e-3)
    cutter = flat_end_mill(diameter=2 * RADIUS, teeth=2, helix_angle=helix)
    plan = choose_engagement(stock, cutter, axial_depth=DEPTH, **sizes)
    return Process(stock, cutter, PAPER_LAW, 837.0, plan)


FINE = {"angles": 96, "element_height": 0.4e-3}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("direction", "is_held_back"), [(0.0, False), (2.4, False), (0.0, True)]
)
def test_chip_of_a_slot_is_that_of_two_circles(direction, is_held_back):
    """A slot in any direction shows the same chip from 0 to 180 degrees.

    So does a helix that holds the discs back by half a sample, three halves, ...
    """
    along = np.array([np.cos(direction), np.sin(direction), 0.0])
    steps = np.arange(60)[:, None]
    tips = (steps * FEED - 1.5e-3) * along + np.array([0.0, 0.0, -DEPTH])
    helix = np.arctan(2 * np.pi / 96 * RADIUS / 0.4e-3) if is_held_back else 0.0
    process = process_of(5e-3, float(helix), **FINE)
    plan: Any = process.engagement
    chart = Replay.along(process, Pose(jnp.asarray(tips)), 50).tooth_chip()
    phi = chart.immersion_angle
    assert np.ptp(phi) == pytest.approx(2 * np.pi * (1 - 1 / plan.angles))
    # symbols: h chip, u_e part of the feed along the tooth; R^2 - across^2 remains
    along_tooth, across = -FEED * np.sin(phi), FEED * np.cos(phi)
    h = RADIUS - (along_tooth + np.sqrt(RADIUS**2 - across**2))
    inside = (phi > np.deg2rad(8)) & (phi < np.deg2rad(172))
    full = chart.height + plan.discs.height / 2 < DEPTH - 0.1e-3
    assert full.any()
    for element in np.flatnonzero(full):
        drawn = chart.chip_thickness[element] * chart.weight[element]
        # A chart of a helix is true to half a sample.
        rtol = 0.3 if is_held_back else 0.02
        np.testing.assert_allclose(drawn[inside], h[inside], rtol=rtol)
        behind = (phi < np.deg2rad(-8)) | (phi > np.deg2rad(188))
        np.testing.assert_allclose(drawn[behind], 0.0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("row", [50, 51])
@pytest.mark.parametrize("direction", [0.0, np.pi / 2])
def test_a_chip_is_of_one_pass_of_a_tooth(direction, row):
    """Each tooth cuts more than the one before: two passes would leave a jump."""
    along = np.array([np.cos(direction), np.sin(direction), 0.0])
    way = np.cumsum(FEED * (1 + 0.05 * np.arange(60)))[:, None] - 4e-3
    process = process_of(6e-3, **FINE)
    tips = jnp.asarray(way * along + np.array([0.0, 0.0, -DEPTH]))
    chart = Replay.along(process, Pose(tips), row).tooth_chip()
    near = np.abs(chart.immersion_angle - np.pi / 2) < 0.4
    chip = chart.chip_thickness[0, near]
    assert chip.min() > FEED
    # symbols: h = f sin(phi), whose second difference is h times the square of the step
    step = 2 * np.pi / FINE["angles"]
    assert np.abs(np.diff(chip, 2)).max() < 2 * step**2 * chip.max()


def test_step_outside_the_path_is_refused():
    with pytest.raises(ValueError, match=r"`chip_row`.* 1 .* 4"):
        Replay.along(process_of(4e-3), Pose(jnp.zeros((5, 3))), 5)


def test_force_record_puts_samples_in_the_middle_of_their_parts():
    time = 0.1 * np.arange(4)
    samples = np.arange(4 * 5 * 3, dtype=float).reshape(4, 5, 3)
    record = ForceTrace.from_periods(time, samples)
    np.testing.assert_allclose(record.time, 0.01 + 0.02 * np.arange(15))
    np.testing.assert_array_equal(record.force[0], samples[1, 0])
    np.testing.assert_array_equal(record.force[-1], samples[3, 4])
    assert record.tooth_period == pytest.approx(0.1)
    assert record.sample_rate == pytest.approx(50.0)
