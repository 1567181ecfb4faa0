import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffmill import cutter as ct

from .mills import CORNERS, R, mill


def area(elements):
    return float(jnp.sum(2 * math.pi * elements.radius * elements.width))


@pytest.mark.parametrize("name", CORNERS)
def test_widths_sum_to_the_length_of_the_profile(name):
    rc = CORNERS[name]
    elements = mill(name).elements(3, 5, 4, 0.5e-3, jnp.float64)
    wanted = R - rc + rc * math.pi / 2 + 4 * 0.5e-3
    np.testing.assert_allclose(float(jnp.sum(elements.width)), wanted, rtol=1e-12)
    assert elements.bottom_count == 3 and elements.height.shape == (12,)


def test_a_ball_has_the_area_of_half_a_sphere_with_an_error_of_second_order():
    wanted = 2 * math.pi * R**2
    coarse, fine = (
        area(mill("ball").elements(0, n, 0, 1e-3, jnp.float64)) / wanted - 1
        for n in (20, 40)
    )
    assert abs(coarse) < 3e-4
    np.testing.assert_allclose(coarse / fine, 4, rtol=1e-2)


def test_a_part_of_a_ball_has_the_area_of_a_cap():
    limit = 0.7
    elements = mill("ball").elements(0, 400, 0, 1e-3, jnp.float64, corner_limit=limit)
    cap = 2 * math.pi * R**2 * (1 - math.cos(limit))
    np.testing.assert_allclose(area(elements), cap, rtol=1e-5)


def test_a_bull_nose_has_the_area_of_disc_torus_and_cylinder():
    rc = CORNERS["bull"]
    elements = mill("bull").elements(200, 200, 3, 1e-3, jnp.float64)
    disc = math.pi * (R - rc) ** 2
    torus = 2 * math.pi * rc * ((R - rc) * math.pi / 2 + rc)
    np.testing.assert_allclose(
        area(elements), disc + torus + 2 * math.pi * R * 3e-3, rtol=1e-5
    )


@pytest.mark.parametrize("name", CORNERS)
def test_elements_lie_on_the_swept_solid_with_its_normals(name):
    tool = mill(name)
    elements = tool.elements(4, 6, 5, 0.5e-3, jnp.float64)
    is_real = elements.width > 0
    zero = jnp.zeros_like(elements.height)
    points = jnp.stack([elements.radius, zero, elements.height], axis=-1)[is_real]
    tip, axis = jnp.zeros(3), jnp.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(tool.level(points, tip, axis), 0, atol=1e-15)
    normals = jnp.stack([elements.sin_kappa, zero, -elements.cos_kappa], axis=-1)
    np.testing.assert_allclose(
        tool.normal(points, tip, axis), normals[is_real], atol=1e-9
    )
    order = np.diff(elements.height[is_real]) + np.diff(elements.radius[is_real])
    assert (order > 0).all()


def test_the_lag_is_that_of_a_helix_of_constant_lead():
    tool = ct.ball_end_mill(10e-3, 2, math.radians(30))
    elements = tool.elements(0, 5, 2, 1e-3, jnp.float64)
    wanted = 2 * elements.height * math.tan(math.radians(30)) / 10e-3
    np.testing.assert_allclose(elements.lag, wanted, rtol=1e-12)


def test_elements_follow_the_sizes():
    def ball_width(diameter):
        tool = ct.ball_end_mill(diameter, 2, nominal_diameter=10e-3)
        return jnp.sum(tool.elements(0, 5, 0, 1e-3, jnp.float64).width)

    slope = jax.grad(ball_width)(jnp.asarray(10e-3))
    np.testing.assert_allclose(slope, math.pi / 4, rtol=1e-12)

    def bull_lag(corner, helix):
        tool = ct.bull_nose(10e-3, 2, corner, helix, nominal_corner_radius=1e-3)
        elements = tool.elements(0, 0, 1, 1e-3, jnp.float64)
        return elements.lag[0]

    by_corner, by_helix = jax.grad(bull_lag, argnums=(0, 1))(
        jnp.asarray(1e-3), jnp.asarray(0.5)
    )
    np.testing.assert_allclose(by_corner, math.tan(0.5) / 5e-3, rtol=1e-12)
    np.testing.assert_allclose(by_helix, 0.3 / math.cos(0.5) ** 2, rtol=1e-12)


def test_single_precision_elements():
    elements = mill("bull").elements(2, 3, 4, 1e-3, jnp.float32)
    assert {x.dtype for x in jax.tree.leaves(elements)} == {jnp.dtype("float32")}


@pytest.mark.parametrize(
    ("bottom", "side", "limit"), [(-1, 1, 1.0), (1, -2, 1.0), (1, 1, 2.0)]
)
def test_impossible_elements_are_refused(bottom, side, limit):
    with pytest.raises(ValueError, match="corner_limit"):
        mill("bull").elements(bottom, 1, side, 1e-3, jnp.float64, corner_limit=limit)
