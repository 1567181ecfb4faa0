import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffmill import cutter as ct

UNEVEN = (1.5, 1.6, 1.5, 2 * math.pi - 4.6)


@pytest.mark.parametrize(
    ("tool", "kind", "corner", "is_plain"),
    [
        (ct.flat_end_mill(10e-3, 4), "flat", 0.0, True),
        (ct.ball_end_mill(10e-3, 4), "ball", 5e-3, False),
        (ct.bull_nose(10e-3, 4, 1e-3), "bull", 1e-3, False),
        (ct.flat_end_mill(10e-3, 4, pitch=UNEVEN), "flat", 0.0, False),
        (ct.flat_end_mill(10e-3, 4, pitch=[math.pi / 2] * 4), "flat", 0.0, True),
        (ct.flat_end_mill(10e-3, 4, runout=1e-6), "flat", 0.0, False),
    ],
)
def test_static_facts(tool, kind, corner, is_plain):
    assert (tool.kind, tool.is_plain) == (kind, is_plain)
    assert tool.corner_radius == pytest.approx(corner)
    assert tool.nominal_corner_radius == pytest.approx(corner)
    assert tool.nominal_radius == 5e-3 and tool.flute_length == pytest.approx(30e-3)


def test_even_and_uneven_pitch():
    even = ct.flat_end_mill(10e-3, 4)
    np.testing.assert_allclose(even.pitch_angles, np.arange(4) * math.pi / 2)
    assert even.has_even_pitch
    uneven = ct.flat_end_mill(10e-3, 4, pitch=UNEVEN)
    np.testing.assert_allclose(uneven.pitch_angles, [0, 1.5, 3.1, 4.6], rtol=1e-12)
    assert not uneven.has_even_pitch


def test_runout_moves_the_teeth_apart():
    tool = ct.flat_end_mill(10e-3, 2, runout=5e-6, runout_angle=0.4)
    wanted = 5e-6 * np.array([math.cos(0.4), -math.cos(0.4)])
    np.testing.assert_allclose(tool.runout_offsets(), wanted, rtol=1e-12)
    # The exact distance of a tooth from the axis of rotation, to first order.
    tooth = 5e-3 * np.array([1.0, 0.0]) + 5e-6 * np.array(
        [math.cos(0.4), math.sin(0.4)]
    )
    np.testing.assert_allclose(
        np.linalg.norm(tooth) - 5e-3, tool.runout_offsets()[0], rtol=1e-3
    )


def test_runout_turns_with_the_helix():
    tool = ct.flat_end_mill(10e-3, 2, math.radians(45), runout=5e-6, runout_angle=0.4)
    lag = np.array([0.0, 0.7, math.pi])
    found = tool.runout_offsets(jnp.asarray(lag))
    # The exact distance of edges from the axis of rotation, to first order.
    phi = np.array([0.0, math.pi])[:, None] - lag
    edges = 5e-3 * np.exp(1j * phi) + 5e-6 * np.exp(0.4j)
    np.testing.assert_allclose(np.abs(edges) - 5e-3, found, rtol=0, atol=5e-9)
    np.testing.assert_allclose(found[:, 2], -found[:, 0], rtol=1e-12)


def test_traced_pitch_and_runout_are_differentiated_and_not_plain():
    def offset(pitch, runout):
        tool = ct.flat_end_mill(10e-3, 4, pitch=pitch, runout=runout)
        assert not tool.is_plain and not tool.has_even_pitch
        return tool.runout_offsets()[2]

    by_pitch, by_runout = jax.grad(offset, argnums=(0, 1))(
        jnp.asarray(UNEVEN), jnp.asarray(5e-6)
    )
    # d/dp of e cos(-(p_0 + p_1)).
    slope = -5e-6 * math.sin(3.1)
    np.testing.assert_allclose(by_pitch, [slope, slope, 0, 0], rtol=1e-9)
    np.testing.assert_allclose(by_runout, math.cos(3.1), rtol=1e-12)
    assert jax.grad(lambda e: ct.flat_end_mill(10e-3, 2, runout=e).runout_offsets()[1])(
        jnp.asarray(0.0)
    ) == pytest.approx(-1)


def test_a_cast_cutter_offers_its_offsets_in_single_precision():
    tool = ct.flat_end_mill(10e-3, 2, runout=5e-6)
    tool = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), tool)
    assert tool.runout_offsets().dtype == jnp.float32


def test_static_sizes_stay_when_sizes_are_traced():
    def of(diameter, corner):
        tool = ct.bull_nose(
            diameter, 2, corner, nominal_diameter=10e-3, nominal_corner_radius=1e-3
        )
        assert (tool.nominal_radius, tool.nominal_corner_radius) == (5e-3, 1e-3)
        return tool.corner_radius + tool.diameter

    assert jax.jit(of)(10e-3, 1e-3) == pytest.approx(11e-3)
    with pytest.raises(ValueError, match="nominal_corner_radius"):
        jax.jit(lambda c: ct.bull_nose(10e-3, 2, c).corner_radius)(1e-3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"diameter": -1e-3}, "`diameter` must be finite and positive"),
        ({"diameter": math.nan}, "`diameter` must be finite and positive"),
        ({"diameter": 10}, "`diameter` must be in metres, 1 at most, but is 10"),
        ({"teeth": 0}, "`teeth` must be at least 1"),
        ({"flute_length": 0.0}, "`flute_length`"),
        ({"helix_angle": 1.6}, "`helix_angle`"),
        ({"corner_radius": 5e-3}, "`corner_radius` must be above 0"),
        ({"corner_radius": 0.0}, "`corner_radius` must be above 0"),
        ({"corner_radius": math.nan}, "`corner_radius` must be above 0"),
        ({"runout": math.inf}, "`runout`"),
        ({"runout": 6e-3}, "`runout`"),
        ({"runout_angle": math.nan}, "`runout_angle`"),
        ({"pitch": [3.0, 3.0]}, "sums to 6"),
        ({"pitch": [7.0, 7.0 - 4 * math.pi]}, "positive"),
        ({"pitch": [2 * math.pi]}, "2 positive angles"),
    ],
)
def test_impossible_cutters_are_refused(options, message):
    sizes = {"diameter": 1e-2, "teeth": 2, "corner_radius": 1e-3} | options
    with pytest.raises(ValueError, match=message):
        ct.bull_nose(**sizes)


def test_slopes_of_upright_walls_are_refused_for_round_ends():
    tip, end = jnp.zeros((1, 3)), jnp.ones(1)
    with pytest.raises(ValueError, match='"flat"'):
        ct.ball_end_mill(10e-3, 2).wall_slopes(0, end, end, tip)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("runout", 1e-6),
        ("helix_angle", 0.5),
        ("dish_angle", 0.03),
        ("pitch_angles", np.array([0.0, 2.5])),
        ("pitch_angles", np.zeros(3)),
    ],
)
def test_values_that_a_cutter_was_not_made_for_are_refused(name, value):
    """A plain cutter takes a program that knows neither run-out nor pitch."""
    mill = ct.flat_end_mill(10e-3, 2)
    with pytest.raises(ValueError, match=f"`{name}`"):
        dataclasses.replace(mill, **{name: value})
    assert dataclasses.replace(mill, diameter=9e-3, runout_angle=1.0).is_plain
