import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffmill import cutter as ct

TIP = jnp.array([1e-3, -2e-3, 0.5e-3])


def mill(diameter=10e-3):
    return ct.flat_end_mill(diameter, 2, nominal_diameter=10e-3)


def test_rays_hit_the_cylinder_where_they_should():
    b, c = jnp.array([-2e-3, 2e-3, 4e-3]), jnp.array([1e-3, 1e-3, 1e-3])
    low, high, hit = mill().intersect(0, b, c, TIP)
    # At distance 0 and 4 mm from the axis the half chord is 5 and 3 mm.
    np.testing.assert_allclose(low[:2], [-4e-3, -2e-3], atol=1e-12)
    np.testing.assert_allclose(high[:2], [6e-3, 4e-3], atol=1e-12)
    assert hit.tolist() == [True, True, False]


def test_nothing_is_hit_below_the_tip_and_all_above_it():
    c = jnp.array([0.4e-3, 0.6e-3])
    _, _, hit = mill().intersect(0, jnp.full(2, -2e-3), c, TIP)
    assert hit.tolist() == [False, True]
    low, high, hit = mill().intersect(2, jnp.array([1e-3]), jnp.array([-2e-3]), TIP)
    assert bool(hit[0]) and float(low[0]) == 0.5e-3 and float(high[0]) > 1


def test_rays_along_y_are_indexed_z_then_x():
    low, high, hit = mill().intersect(1, jnp.array([1e-3]), jnp.array([5e-3]), TIP)
    np.testing.assert_allclose([low[0], high[0]], [-5e-3, 1e-3], atol=1e-12)
    assert bool(hit[0])


@pytest.mark.parametrize("family", [0, 1])
def test_wall_slopes_are_the_derivatives_of_the_hit_points(family):
    across, height = 0.7e-3, 1e-3
    b, c = (across, height) if family == 0 else (height, across)

    def end(tip, diameter):
        _, high, _ = mill(diameter).intersect(
            family, jnp.array([b]), jnp.array([c]), tip
        )
        return high[0]

    by_tip, by_diameter = jax.grad(end, argnums=(0, 1))(TIP, jnp.asarray(10e-3))
    sideways, by_radius = mill().wall_slopes(
        family, jnp.array([end(TIP, 10e-3)]), jnp.array([across]), TIP[None]
    )
    np.testing.assert_allclose(by_tip[family], 1.0, rtol=1e-12)
    np.testing.assert_allclose(by_tip[1 - family], sideways[0], rtol=1e-10)
    np.testing.assert_allclose(2 * by_diameter, by_radius[0], rtol=1e-10)


def test_gradients_are_finite_at_grazing_rays():
    def total(tip):
        low, high, hit = mill().intersect(
            0, jnp.array([3e-3, 3.1e-3]), jnp.full(2, 1e-3), tip
        )
        return jnp.sum(jnp.where(hit, high - low, 0))

    assert np.isfinite(jax.grad(total)(TIP)).all()


@pytest.mark.parametrize("wrap", [lambda f: f, jax.jit], ids=["eager", "jit"])
@pytest.mark.parametrize("corner_radius", [5e-3, 2e-3], ids=["ball", "bull"])
def test_columns_in_line_with_the_side_of_a_round_end_have_a_bounded_slope(
    corner_radius, wrap
):
    # 3 mm and 4 mm aside is at the radius, and rounding says whether that is a hit.
    b = jnp.full(12, 3e-3)
    c = 4e-3 * (1 - np.finfo(float).eps * jnp.arange(-3.0, 9.0))

    def lowest(x):
        tool = ct.ball_end_mill(x[3], 2, nominal_diameter=10e-3)
        if corner_radius < 5e-3:
            tool = ct.bull_nose(x[3], 2, corner_radius, nominal_diameter=10e-3)
        low, _, hit = tool.intersect(2, b, c, x[:3])
        return low, hit

    x = jnp.array([0.0, 0.0, 0.0, 10e-3])
    low, hit = wrap(lowest)(x)
    assert 0 < hit.sum() < 12
    np.testing.assert_allclose(low[hit], corner_radius, atol=1e-6)
    for slopes in (jax.jacfwd, jax.jacrev):
        found, _ = wrap(slopes(lowest, has_aux=True))(x)
        assert np.isfinite(found).all()
        assert 500 < np.abs(found).max() <= 1000


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"diameter": -1e-3, "teeth": 2}, "diameter"),
        ({"diameter": 1e-2, "teeth": 0}, "teeth"),
        ({"diameter": 1e-2, "teeth": 2, "flute_length": 0.0}, "flute_length"),
    ],
)
def test_impossible_cutters_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        ct.flat_end_mill(**options)
