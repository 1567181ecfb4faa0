import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffmill.numerics import eager_jacobian, eager_row_jacobian

RNG = np.random.default_rng(3)


class Place(eqx.Module):
    at: jax.Array
    along: jax.Array | None = None


def force(place, weights, scale, tooth):
    share = weights * jnp.sin(weights + jnp.sum(place.at))
    other = 0.0 if place.along is None else jnp.sum(place.along**2)
    return scale * jnp.stack(
        [jnp.sum(share), jnp.sum(share[tooth]) * other, place.at[0] ** 3]
    )


def occupied(points, ends, is_upper, width):
    s = jnp.where(is_upper, ends["x"] - points[:, :1], points[:, :1] - ends["x"])
    inside = jnp.tanh(s / width)
    return jnp.stack([jnp.sum(inside, axis=1) * points[:, 1], inside[:, 0] ** 2], 1)


FORCE = (
    Place(jnp.asarray(RNG.normal(size=3)), jnp.asarray(RNG.normal(size=2))),
    jnp.asarray(RNG.normal(size=(4, 2))),
    jnp.asarray(1.7),
    jnp.asarray(2),
)
OCCUPIED = (
    jnp.asarray(RNG.normal(size=(5, 2))),
    {"x": jnp.asarray(RNG.normal(size=(5, 4)))},
    jnp.asarray(RNG.random((5, 4)) > 0.5),
    0.3,
)
CASES = {
    "few outputs": (force, eager_jacobian(force), FORCE),
    "rows": (occupied, eager_row_jacobian(occupied), OCCUPIED),
}


def in_its_floats(function, args):
    """Return a function of the floating arrays of `args`, and these."""
    free, fixed = eqx.partition(args, eqx.is_inexact_array)
    return (lambda x: function(*eqx.combine(x, fixed))), free


@pytest.fixture(params=CASES.values(), ids=list(CASES))
def both(request):
    plain, kept, args = request.param
    return in_its_floats(plain, args)[0], *in_its_floats(kept, args)


def like(tree):
    rng = np.random.default_rng(4)
    return jax.tree.map(lambda x: jnp.asarray(rng.normal(size=x.shape)), tree)


def test_forward_mode_is_that_of_the_function(both):
    plain, kept, at = both
    for a, b in zip(
        jax.jvp(plain, (at,), (like(at),)),
        jax.jit(lambda x, t: jax.jvp(kept, (x,), (t,)))(at, like(at)),
        strict=True,
    ):
        np.testing.assert_allclose(b, a, rtol=1e-12)


def test_reverse_mode_is_that_of_the_function(both):
    plain, kept, at = both
    out, expected = jax.vjp(plain, at)
    found = jax.vjp(kept, at)[1](like(out))
    assert jax.tree.all(
        jax.tree.map(
            lambda a, b: np.allclose(a, b, rtol=1e-12),
            expected(like(out)),
            found,
        )
    )


def test_second_derivatives_are_those_of_the_function(both):
    plain, kept, at = both
    curved = lambda f: jax.jvp(
        jax.grad(lambda x: jnp.sum(f(x) ** 2)), (at,), (like(at),)
    )[1]
    for a, b in zip(*(jax.tree.leaves(curved(f)) for f in (plain, kept)), strict=True):
        np.testing.assert_allclose(b, a, rtol=1e-9, atol=1e-12)


def test_what_does_not_move_takes_no_part(both):
    # Linear programs hold slopes with respect to what is differentiated, no more.
    _, kept, at = both
    first, *rest = jax.tree.leaves(at)
    structure = jax.tree.structure(at)
    alone = lambda x: kept(jax.tree.unflatten(structure, [x, *rest]))
    out, linear = jax.linearize(alone, first)
    sizes = [x.size for x in jax.tree.leaves(linear)]
    assert max(sizes) <= out.size * first.size
    expected = jax.jvp(alone, (first,), (like(first),))[1]
    np.testing.assert_allclose(linear(like(first)), expected, rtol=1e-12)


def test_a_batch_has_slopes_of_its_own():
    plain, at = in_its_floats(force, FORCE)
    kept, _ = in_its_floats(eager_jacobian(force), FORCE)
    batch = jax.tree.map(lambda x: jnp.stack([x, 2 * x]), at)
    push = lambda f: jax.vmap(lambda x: jax.jvp(f, (x,), (like(at),))[1])(batch)
    np.testing.assert_allclose(push(kept), push(plain), rtol=1e-12)


def test_rows_that_share_a_number_are_refused():
    shared = eager_row_jacobian(lambda points, width: points / width)
    with pytest.raises(ValueError, match=r"one entry per row, 5, .* shape \(\)"):
        jax.grad(lambda width: jnp.sum(shared(OCCUPIED[0], width)))(2.0)
