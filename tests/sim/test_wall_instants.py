"""The instants at which a wall is made, and what the tool does there."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from diffmill import cutter as ct, sim, workpiece as wp

ROWS, SUBSTEPS, FEED = 12, 40, 0.1e-3


def path(degrees):
    """Return a straight path at an angle to work x."""
    way = FEED * np.arange(ROWS)
    angle = math.radians(degrees)
    return np.stack([way * math.cos(angle), way * math.sin(angle), 0 * way - 1e-3], 1)


def looks_at(shares, teeth):
    """Return the angles of the teeth at the shares of their periods, (row, tooth)."""
    turn = 2 * math.pi / teeth * (np.arange(ROWS) - 1 + np.asarray(shares))
    return turn[:, None] + 2 * math.pi / teeth * np.arange(teeth)[None]


@pytest.mark.parametrize("teeth", [2, 3, 4])
@pytest.mark.parametrize("degrees", [0, 33, 90, 215])
def test_a_tooth_looks_to_the_left_of_the_feed(teeth, degrees):
    mill = ct.flat_end_mill(10e-3, teeth)
    shares = sim.wall_shares(jnp.asarray(path(degrees)), None, mill)
    assert (np.asarray(shares) > 0).all() and (np.asarray(shares) <= 1).all()
    # Immersion angles count from +y clockwise: the left of the feed is at -degrees.
    off = looks_at(shares, teeth) + math.radians(degrees)
    nearest = np.abs(np.mod(off + math.pi, 2 * math.pi) - math.pi).min(axis=1)
    np.testing.assert_allclose(nearest[1:], 0, atol=1e-5)


def test_three_teeth_look_to_the_side_where_material_stays():
    mill = ct.flat_end_mill(10e-3, 3)
    stock = wp.box([-2e-3, -9e-3, -2e-3], [4e-3, -5e-3, 0], 0.25e-3)
    shares = sim.wall_shares(jnp.asarray(path(0)), None, mill, stock)
    off = looks_at(shares, 3) - math.pi
    nearest = np.abs(np.mod(off + math.pi, 2 * math.pi) - math.pi).min(axis=1)
    np.testing.assert_allclose(nearest[1:], 0, atol=1e-5)


def test_a_shaking_tool_is_seen_as_it_stands_when_the_wall_is_made():
    mill = ct.flat_end_mill(10e-3, 2)
    desired = path(33)
    shares = sim.wall_shares(jnp.asarray(desired), None, mill)
    time = np.arange(ROWS)[:, None] - 1 + (np.arange(SUBSTEPS) + 1) / SUBSTEPS
    shake = lambda t: 20e-6 * np.sin(2 * math.pi * 1.7 * t + 0.3)
    along = np.interp(time, np.arange(ROWS), FEED * np.arange(ROWS))
    ends = along[..., None] * (desired[-1] - desired[0]) / (FEED * (ROWS - 1))
    ends = ends + desired[0] + shake(time)[..., None] * np.array([0.0, 1.0, 0.0])
    found = sim.wall_deviation(jnp.asarray(ends), jnp.asarray(desired), shares)
    wanted = shake(np.arange(ROWS) - 1 + np.asarray(shares))
    np.testing.assert_allclose(found[1:, 1], wanted[1:], atol=0.3e-6)
    np.testing.assert_allclose(found[1:, [0, 2]], 0, atol=1e-12)
    # At the tooth instants it stands elsewhere.
    assert np.abs(shake(np.arange(ROWS)) - wanted).max() > 10e-6
