import dataclasses
import math

import numpy as np
import pytest

from diffmill import cutter as ct, identification

K = np.array([900e6, 300e6, 100e6, 10e3, 15e3, 5e3])


def columns():
    """Two cuts of unlike length and depth, a pause between them."""
    spacing = 1e-4
    time = spacing * np.arange(8000)
    depth = np.where((time > 0.1) & (time < 0.3), 1.0, 0.0)
    depth += np.where((time > 0.45) & (time < 0.7), 0.6, 0.0)
    wave = np.maximum(np.sin(2 * np.pi * 133.3 * time), 0.0)
    found = np.zeros((len(time), 3, 6))
    for axis, share in enumerate((1.0, -0.7, 0.2)):
        found[:, axis, axis] = 1e-7 * share * depth * wave
        found[:, axis, 3 + axis] = 1e-3 * share * (depth > 0) * (wave > 0)
    return identification.EngagementColumns(
        0.5 * spacing, spacing, found, np.zeros((len(time), 3)), 0 * found
    )


@pytest.mark.parametrize("start", [-3.2, 0.0, 0.25, 12345.0])
def test_a_record_on_any_clock_and_in_any_axes_meets_its_cut(start):
    found = columns()
    force = found.columns @ K
    grid = found.start + found.spacing * np.arange(len(force))
    # The record begins 0.2 s before the cut and goes on after it, or begins late.
    first = 0.12 if start == 0.25 else -0.2
    time = np.arange(first, 1.3, 1.7e-4)
    seen = np.column_stack([np.interp(time, grid, f, 0, 0) for f in force.T])
    seen += np.random.default_rng(0).normal(size=seen.shape)
    seen = seen[:, [2, 0, 1]] * np.array([1.0, -1.0, 1.0])[None]
    clock = time - time[0] + start
    seen[100:110] = np.nan
    # Coefficients half as large again do not matter.
    met = identification.align_in_time(found, 1.5 * K, clock, seen)
    assert abs(met.shift - (time[0] - start)) < 2.5e-4
    assert met.quality > 0.9
    np.testing.assert_allclose(met.overlap, 1.0 if first < 0 else 0.95, atol=0.03)


def test_nothing_to_meet_is_said():
    found = columns()
    time = np.linspace(0, 1, 100)
    with pytest.raises(ValueError):
        identification.align_in_time(found, K, time, np.zeros((100, 3)))
    idle = dataclasses.replace(found, columns=0 * found.columns)
    with pytest.raises(ValueError):
        identification.align_in_time(idle, K, time, np.ones((100, 3)))


def test_immersion_of_straight_cuts():
    assert identification.StraightCut.immersion(10e-3, None, "slot") == (0.0, math.pi)
    up = identification.StraightCut.immersion(10e-3, 2.5e-3, "up")
    np.testing.assert_allclose(up, (0.0, math.pi / 3))
    down = identification.StraightCut.immersion(10e-3, 2.5e-3, "down")
    np.testing.assert_allclose(down, (2 * math.pi / 3, math.pi))
    with pytest.raises(ValueError, match="radial_depth"):
        identification.StraightCut.immersion(10e-3, None, "up")
    with pytest.raises(ValueError, match="radial_depth"):
        identification.StraightCut.immersion(10e-3, 2e-3, "slot")
    with pytest.raises(ValueError, match="radial_depth"):
        identification.StraightCut.immersion(10e-3, 11e-3, "down")


@pytest.mark.parametrize(
    ("side", "width", "low", "high"),
    [
        ("slot", None, -6e-3, 6e-3),
        ("up", 2e-3, 3e-3, 6e-3),
        ("down", 2e-3, -6e-3, -3e-3),
    ],
)
def test_stock_lies_where_the_teeth_enter_or_leave(side, width, low, high):
    cutter = ct.flat_end_mill(10e-3, 2)
    sizes = identification.StraightCut(cutter, 600.0, 0.1e-3, 2e-3, width, side)
    cut = sizes.cut(teeth=20)
    vertices = np.asarray(cut.stock.to_mesh().vertices)
    np.testing.assert_allclose(vertices[:, 1].min(), low, atol=1e-9)
    np.testing.assert_allclose(vertices[:, 1].max(), high, atol=1e-9)
    np.testing.assert_allclose(vertices[:, 2].max(), 0.0, atol=1e-9)
    assert cut.positions.shape == (21, 3)
