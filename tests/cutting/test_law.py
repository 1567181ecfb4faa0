import math
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffmill import cutter, cutting, sim, workpiece

LINEAR = cutting.LinearEdgeLaw(2e9, 8e8, 3e8, 2e4, 3e4, 5e3)
# The exponents differ, so that mixed-up components show.
KIENZLE = cutting.KienzleLaw(1.8e9, 6e8, 2e8, 0.25, 0.4, 0.1, 2e4, 3e4, 5e3)
LEAST = 1e-6


def forces(law, h, touch=1.0, tooth=0):
    h = jnp.atleast_1d(jnp.asarray(h, jnp.float64))
    index = jnp.full(h.shape, tooth, jnp.int32)
    return jnp.stack(law.force_per_width(h, jnp.full_like(h, touch), index), -1)


def test_linear_by_hand():
    # 2000 N/mm^2 * 0.1 mm + 20 N/mm = 220 N/mm, and so on.
    np.testing.assert_allclose(forces(LINEAR, 1e-4), [[2.2e5, 1.1e5, 3.5e4]])


def test_kienzle_by_hand():
    # k_c1.1 = 1500 N/mm^2 and m = 0.25 at 0.0625 mm: the fourth root of 1/16 is 1/2,
    # so k_c = 3000 N/mm^2 and the force 187.5 N/mm. With m = 0.5, k_c is four times
    # 1500 N/mm^2; with m = 0 it is 1500 N/mm^2.
    law = cutting.KienzleLaw(1.5e9, 1.5e9, 1.5e9, 0.25, 0.5, 0.0)
    np.testing.assert_allclose(
        forces(law, 62.5e-6), [[187.5e3, 375e3, 93.75e3]], rtol=1e-12
    )
    # At the reference thickness it is k_c1.1 whatever the exponent.
    np.testing.assert_allclose(forces(law, 1e-3), np.full((1, 3), 1.5e6), rtol=1e-12)


def test_twice_the_chip():
    law = cutting.KienzleLaw(1.8e9, 6e8, 2e8, 0.25, 0.4, 0.1)
    ratio = forces(law, 8e-5) / forces(law, 4e-5)
    np.testing.assert_allclose(ratio, [[2**0.75, 2**0.6, 2**0.9]], rtol=1e-12)


def test_exponential_form_of_altintas():
    # K_T in N/mm^2 with h in mm is k_c1.1 in N/mm^2; in SI the reference is 1 m.
    K_T, p, h = 700.0, 0.3, 0.05
    wanted = K_T * h**-p * h * 1e3
    same = cutting.KienzleLaw(K_T * 1e6, 0.0, 0.0, p, 0.0, 0.0)
    K_T_SI = K_T * 1e6 * 1e-3**p
    si = cutting.KienzleLaw(K_T_SI, 0.0, 0.0, p, 0.0, 0.0, reference_thickness=1.0)
    for law in (same, si):
        np.testing.assert_allclose(forces(law, h * 1e-3)[0, 0], wanted, rtol=1e-12)


@pytest.mark.parametrize("law", [LINEAR, KIENZLE, KIENZLE.for_bottom()])
def test_no_chip_no_force(law):
    np.testing.assert_array_equal(forces(law, 0.0, touch=0.0), 0)
    edge = forces(law, 0.0)[0]
    np.testing.assert_allclose(edge[:2], [2e4, 3e4])


def test_below_the_least_thickness_the_coefficient_follows_its_tangent():
    K, m = 1.8e9, 0.25
    law = cutting.KienzleLaw(K, 0.0, 0.0, m, 0.0, 0.0)

    def force(h):
        return forces(law, h)[0, 0]

    K_0 = K * (LEAST / 1e-3) ** -m
    np.testing.assert_allclose(jax.grad(force)(0.0), (1 + m) * K_0, rtol=1e-12)
    np.testing.assert_allclose(force(LEAST / 2), K_0 * (1 + m / 2) * LEAST / 2)
    # Value and slope have no jump there, the power law goes on above.
    low, high = LEAST * (1 - 1e-9), LEAST * (1 + 1e-9)
    np.testing.assert_allclose(force(low), force(high), rtol=1e-8)
    np.testing.assert_allclose(jax.grad(force)(low), jax.grad(force)(high), rtol=1e-8)
    np.testing.assert_allclose(jax.grad(force)(LEAST), (1 - m) * K_0, rtol=1e-12)
    h = np.linspace(0, 3 * LEAST, 301)
    assert np.all(np.diff(forces(law, h)[:, 0]) > 0)


@pytest.mark.parametrize("h", [0.0, 1e-9, 0.3e-6, 0.999e-6, 1.5e-6, 8e-5, 1e-3])
@pytest.mark.parametrize("law", [LINEAR, KIENZLE], ids=["linear", "kienzle"])
def test_gradients_match_differences(law, h):
    leaves, structure = jax.tree.flatten(law)

    def all_forces(h, leaves):
        return forces(jax.tree.unflatten(structure, leaves), h)[0]

    values = [jnp.asarray(leaf, jnp.float64) for leaf in leaves]
    forward = jax.jacfwd(all_forces, (0, 1))(jnp.asarray(h), values)
    backward = jax.jacrev(all_forces, (0, 1))(jnp.asarray(h), values)
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12),
        forward,
        backward,
    )
    size = float(np.linalg.norm(all_forces(h, values))) + 1
    # One-sided at h = 0: there is no chip below. The law is a quadratic there.
    step = 1e-3 * max(h, 1e-7)
    if h == 0.0:
        one = all_forces(step, values) - all_forces(0.0, values)
        two = all_forces(2 * step, values) - all_forces(0.0, values)
        difference = (4 * one - two) / (2 * step)
    else:
        difference = all_forces(h + step, values) - all_forces(h - step, values)
        difference = difference / (2 * step)
    np.testing.assert_allclose(forward[0], difference, rtol=2e-5)
    for index, value in enumerate(values):
        if np.ndim(value) == 0 and value > 0:
            step = 1e-5 * float(value)
            up, down = list(values), list(values)
            up[index], down[index] = value + step, value - step
            change = np.asarray(all_forces(h, up) - all_forces(h, down))
            np.testing.assert_allclose(
                np.asarray(forward[1][index]) * float(value),
                change / 2e-5,
                rtol=1e-5,
                atol=1e-9 * size,
            )


def test_a_coefficient_per_tooth_belongs_to_its_tooth():
    K = jnp.array([1e9, 2e9, 4e9])
    tooth = jnp.array([[2, 0], [1, 2]], jnp.int32)
    h = jnp.array([[1e-4, 2e-4], [3e-4, 0.0]])
    law = cutting.LinearEdgeLaw(K, 5e8, np.asarray(K) / 10)
    F_t, F_r, F_a = law.force_per_width(h, jnp.ones_like(h), tooth)
    np.testing.assert_allclose(F_t, [[4e5, 2e5], [6e5, 0]])
    np.testing.assert_allclose(F_r, 5e8 * h)
    np.testing.assert_allclose(F_a, F_t / 10)
    power = cutting.KienzleLaw(K, 0.0, 0.0, jnp.array([0.5, 0.0, 0.25]), 0.0, 0.0)
    F_t, _, _ = power.force_per_width(
        jnp.full(3, 62.5e-6), jnp.ones(3), jnp.arange(3, dtype=jnp.int32)
    )
    np.testing.assert_allclose(F_t, [1e9 * 4 * 62.5e-6, 2e9 * 62.5e-6, 8e9 * 62.5e-6])


def test_gradient_goes_to_the_tooth_that_cuts():
    def total(K):
        law = cutting.LinearEdgeLaw(K, 0.0, 0.0)
        return jnp.sum(forces(law, [1e-4, 3e-4], tooth=1))

    gradient = jax.grad(total)(jnp.array([1e9, 2e9]))
    np.testing.assert_allclose(gradient, [0, 4e-4])


def test_a_tooth_without_a_coefficient_does_not_pass_unnoticed():
    law = cutting.LinearEdgeLaw(jnp.array([1e9, 2e9]), 0.0, 0.0)
    assert math.isnan(float(forces(law, 1e-4, tooth=2)[0, 0]))


@pytest.mark.parametrize(
    ("coefficients", "words"),
    [
        ("np.ones((2, 2)), 1.0, 1.0", ("`K_tc`", "(2, 2)", "(tooth,)")),
        ("np.ones(0), 1.0, 1.0", ("`K_tc`", "(0,)", "(tooth,)")),
        ("np.ones(2), 1.0, 1.0, np.ones(3)", ("K_tc: 2", "K_te: 3")),
    ],
)
def test_shapes_that_are_refused(coefficients, words):
    # A process in which nobody checks annotations, as a user's.
    code = "import numpy as np; from diffmill.cutting import LinearEdgeLaw as Law; "
    done = subprocess.run(
        [sys.executable, "-c", f"{code}Law({coefficients})"],
        capture_output=True,
        text=True,
        check=False,
    )
    *_, error = done.stderr.strip().splitlines()
    assert error.startswith("ValueError") and all(word in error for word in words)


@pytest.mark.parametrize("law", [LINEAR, KIENZLE], ids=["linear", "kienzle"])
def test_the_bottom_edge_has_no_force_along_the_edge(law):
    h = [0.0, 5e-7, 1e-4]
    side, bottom = forces(law, h), forces(law.for_bottom(), h)
    np.testing.assert_array_equal(bottom[:, :2], side[:, :2])
    np.testing.assert_array_equal(bottom[:, 2], 0)
    assert np.all(np.asarray(side[:, 2]) > 0)


@pytest.mark.parametrize("law", [LINEAR, KIENZLE], ids=["linear", "kienzle"])
def test_jit_vmap_and_float32(law):
    h = jnp.array([0.0, 4e-7, 1e-4, 5e-4])
    plain = forces(law, h)
    np.testing.assert_allclose(jax.jit(forces)(law, h), plain, rtol=1e-12)
    each = jax.vmap(lambda chip: forces(law, chip)[0])(h)
    np.testing.assert_allclose(each, plain, rtol=1e-12)
    single = jnp.stack(
        law.force_per_width(
            h.astype(jnp.float32),
            jnp.ones(4, jnp.float32),
            jnp.zeros(4, jnp.int32),
        ),
        -1,
    )
    assert single.dtype == jnp.float32
    np.testing.assert_allclose(single, plain, rtol=1e-5)


def test_pressure_on_the_rake_face_of_a_right_hand_helix_pulls_toward_the_work():
    # By hand: the edge rises by 1 and falls back by tan(helix), so a radial rake face
    # that holds it has the normal (cos, sin) ahead and up, and a chip without friction
    # pushes the tool the other way: back by K cos, down by K sin.
    helix, K = math.radians(30), 1e9
    mill = cutter.flat_end_mill(10e-3, 2, helix)
    edge = mill.elements(0, 0, 4, 0.5e-3, jnp.float64)
    back = np.diff(edge.lag) * 5e-3
    along = np.stack([-back, np.diff(edge.height)], axis=-1)
    law = cutting.LinearEdgeLaw(K * math.cos(helix), 0.0, -K * math.sin(helix))
    F_t, _, F_a = forces(law, 1e-4)[0]
    on_tool = np.array([-F_t, F_a])
    np.testing.assert_allclose(along @ on_tool, 0, atol=1e-12 * K * 1e-4)
    stock = workpiece.box([0, -6e-3, -2e-3], [12e-3, 6e-3, 0], 0.5e-3)
    x = np.linspace(2e-3, 5e-3, 31)
    path = np.column_stack([x, 0 * x, np.full_like(x, -1e-3)])
    run = lambda path: sim.simulate_process(
        path, stock, mill, law, 800.0, axial_depth=1.5e-3
    )
    force = jax.jit(run)(path).force
    # Up-turned z points to the shank.
    assert float(force[20:, 2].mean()) < -10


def test_whole_numbers_and_lists_are_parameters_too():
    """What is no floating-point number would be left out of scatter and derivatives."""
    rates = [900_000_000, 1_100_000_000]
    law = cutting.LinearEdgeLaw(K_tc=rates, K_rc=337, K_ac=np.int64(60))
    assert law.parameter_names == law.NAMES and law.tooth_count == 2
    power = cutting.KienzleLaw(1500, 400, 100, 0.3, 0.6, 0)
    assert {"K_tc11", "K_rc11", "K_ac11"} <= set(power.parameter_names)
    assert isinstance(power.m_a, float)
    slope = jax.grad(lambda law: jnp.sum(law.K_ac * jnp.ones(2)))(law)
    assert float(slope.K_ac) == 2.0
