"""Late commands: of a ramp in closed form, and what they do to a path."""

import jax.numpy as jnp
import numpy as np
import pytest

from diffmill.correction import delayed

STEP = 4e-3


@pytest.mark.parametrize("delay", [0.0, 4e-3, 10e-3])
def test_a_ramp_comes_late(delay):
    time = STEP * np.arange(50)
    ramp = np.stack([time, 2 * time], axis=1)
    late = np.maximum(time - delay, 0)
    found = delayed(ramp, delay, STEP)
    np.testing.assert_allclose(found, np.stack([late, 2 * late], axis=1), atol=1e-15)
    np.testing.assert_array_equal(delayed(ramp, delay, STEP, nominal=ramp), ramp)


def test_only_the_offset_is_late():
    time = STEP * np.arange(50)
    nominal = jnp.asarray(time[:, None] ** 2)
    offset = jnp.asarray(np.sin(40 * time)[:, None])
    found = delayed(nominal + offset, 2 * STEP, STEP, nominal=nominal)
    np.testing.assert_allclose(found[2:], nominal[2:] + offset[:-2], atol=1e-14)
    np.testing.assert_allclose(found[:3], nominal[:3] + offset[:1], atol=1e-14)
