"""The controller's parts against what is known of them by hand."""

import itertools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
from scipy.linalg import expm

from diffmill.robot import Controller

STEP = 3.75e-3
TIME = STEP * np.arange(400)
SPEED = 0.7


def ramp(joints=1):
    return jnp.asarray(np.tile(SPEED * TIME[:, None], (1, joints)))


def settled(controller, rows):
    """Return the response late in a ramp, over its speed: by how much it lags [s]."""
    found = controller.respond(rows, STEP)
    return np.asarray((rows - found)[250:300]) / SPEED


@pytest.mark.parametrize(
    ("controller", "lag"),
    [
        (Controller(moving_average=60e-3), 30e-3),
        (Controller(moving_average=1e-3), 0.5e-3),
        (Controller(dead_time=17e-3), 17e-3),
        (Controller(low_pass=5.0), 1 / (2 * np.pi * 5.0)),
        (Controller(bandwidth=8.0), 1 / (2 * np.pi * 8.0)),
        (Controller(bandwidth=8.0, damping_ratio=0.7), 1.4 / (2 * np.pi * 8.0)),
        (Controller(bandwidth=8.0, damping_ratio=1.0), 2.0 / (2 * np.pi * 8.0)),
        (Controller(bandwidth=8.0, damping_ratio=1.6), 3.2 / (2 * np.pi * 8.0)),
        (Controller(shaper_frequency=10.0), 25e-3),
        (Controller(interpolation_cycle=12e-3, interpolation="linear"), 12e-3),
        (Controller(interpolation_cycle=12e-3, interpolation="spline"), 24e-3),
    ],
)
def test_a_ramp_comes_late_by_the_mean_delay(controller, lag):
    found = settled(controller, ramp())
    assert np.allclose(found, lag, rtol=1e-6)
    assert np.isclose(float(controller.delay), lag, rtol=1e-6)
    # On a clock that is so much late nothing of it is left.
    at_once = controller.motors(ramp(), STEP)
    assert np.allclose(at_once[150:200], ramp()[150:200], atol=1e-6 * SPEED * lag)


def test_set_points_that_are_held_make_a_staircase():
    held = Controller(interpolation_cycle=12e-3, interpolation="hold")
    found = np.asarray(held.respond(ramp(), STEP))[:, 0]
    assert np.allclose(found, SPEED * 12e-3 * np.floor(TIME / 12e-3 + 1e-9))
    assert np.isclose(float(held.delay), 6e-3)


@pytest.mark.parametrize("zeta", [None, 0.7, 1.0, 1.6])
@pytest.mark.parametrize("cycle", [12e-3, 7.3e-3, 1.1e-3])
def test_a_servo_answers_each_jump_of_a_staircase(cycle, zeta):
    """Held set points jump anywhere in a step, and servos begin to move there."""
    w = 2 * np.pi * 10.0
    rows = 0.3 * np.sin(5.0 * TIME) * np.minimum(TIME / 0.2, 1.0)
    found = Controller(
        interpolation_cycle=cycle,
        interpolation="hold",
        bandwidth=10.0,
        damping_ratio=zeta,
    ).respond(jnp.asarray(rows)[:, None], STEP)
    # From jump to jump the input stands still, and what is left of the lag decays.
    rate = np.array([[-w]]) if zeta is None else np.array([[0, -w], [w, -2 * zeta * w]])
    jumps = cycle * np.arange(int(TIME[-1] / cycle) + 1)
    ends = np.unique(np.concatenate([TIME, jumps]).round(12))
    state, held, wanted = np.zeros(len(rate)), 0.0, {0.0: 0.0}
    for start, end in itertools.pairwise(ends):
        new = np.interp(cycle * np.floor(start / cycle + 1e-6), TIME, rows)
        state[0] += new - held
        held, state = new, expm((end - start) * rate) @ state
        wanted[end] = held - state[0]
    wanted = [wanted[t] for t in TIME.round(12)]
    np.testing.assert_allclose(np.asarray(found)[:, 0], wanted, atol=1e-9)


@pytest.mark.parametrize("zeta", [None, 0.7, 1.6])
def test_several_jumps_in_a_part_of_a_step(zeta):
    """Set points so close are a ramp that is late by half a cycle."""
    cycle, rows = 0.15e-3, ramp()
    servos = {"bandwidth": 150.0, "damping_ratio": zeta}
    found = Controller(
        interpolation_cycle=cycle, interpolation="hold", **servos
    ).respond(rows, STEP)
    straight = Controller(dead_time=cycle / 2, **servos).respond(rows, STEP)
    # Of the lag of such a ramp, by an instant that is anywhere in a cycle.
    off = np.abs(found - straight)[50:].mean() / SPEED
    assert off < 0.3 * cycle, off
    lag = np.asarray(rows - found)[50:250].mean() / SPEED
    wanted = (1 if zeta is None else 2 * zeta) / (2 * np.pi * 150.0) + cycle / 2
    np.testing.assert_allclose(lag, wanted, atol=0.02 * cycle)


def test_every_joint_has_its_own_bandwidth():
    controller = Controller(bandwidth=jnp.asarray([4.0, 16.0]))
    found = settled(controller, ramp(2))
    assert np.allclose(found, 1 / (2 * np.pi * np.array([4.0, 16.0])), rtol=1e-6)


@pytest.mark.parametrize("zeta", [0.3, 1.0, 2.0])
def test_a_servo_follows_its_differential_equation(zeta):
    w = 2 * np.pi * 6.0
    rows = np.sin(9.0 * TIME)[:, None] * np.minimum(TIME / 0.2, 1.0)[:, None]
    found = Controller(bandwidth=6.0, damping_ratio=zeta).respond(
        jnp.asarray(rows), STEP
    )
    # Runge-Kutta on the same polygon, in a hundred parts of a step.
    y = v = 0.0
    wanted, h = [0.0], STEP / 100
    for start, end in zip(rows[:-1, 0], rows[1:, 0], strict=True):
        for part in range(100):
            u = [start + (end - start) * (part + s) / 100 for s in (0.0, 0.5, 1.0)]
            rate = lambda y, v, u: (v, w**2 * (u - y) - 2 * zeta * w * v)
            a = rate(y, v, u[0])
            b = rate(y + h / 2 * a[0], v + h / 2 * a[1], u[1])
            c = rate(y + h / 2 * b[0], v + h / 2 * b[1], u[1])
            d = rate(y + h * c[0], v + h * c[1], u[2])
            y += h / 6 * (a[0] + 2 * b[0] + 2 * c[0] + d[0])
            v += h / 6 * (a[1] + 2 * b[1] + 2 * c[1] + d[1])
        wanted.append(y)
    assert np.allclose(np.asarray(found)[:, 0], wanted, atol=1e-9)


def test_an_input_shaper_leaves_its_oscillator_at_rest():
    """A step of the speed shakes an undamped oscillator; the shaped one does not."""
    frequency, step = 8.0, 0.25e-3
    time = step * np.arange(4000)
    rows = jnp.asarray(np.minimum(time, 0.3)[:, None])
    w = 2 * np.pi * frequency
    oscillator = Controller(bandwidth=frequency, damping_ratio=1e-9)

    def swing(rows):
        y = np.asarray(oscillator.respond(rows, step))[:, 0]
        return np.ptp(y[-int(1 / frequency / step) :]) / 2

    plain = swing(rows)
    shaped = swing(Controller(shaper_frequency=frequency).respond(rows, step))
    assert plain > 0.1 / w
    assert shaped < 1e-4 * plain


FILTERS: dict = {
    "moving_average": 50e-3,
    "shaper_frequency": 10.0,
    "shaper_damping_ratio": 0.05,
    "dead_time": 8e-3,
    "low_pass": 20.0,
}
SERVOS: dict = {"bandwidth": np.array([10.0, 4.0]), "damping_ratio": 0.7}


def in_pieces(controller, rows, hop):
    """Return the motors of a path that is gone through piece by piece."""
    before, ahead = controller.span(STEP)
    state, found = controller.begin(rows[: ahead + 1], STEP, before, ahead), []
    once = eqx.debug.assert_max_traces(max_traces=1)
    follow = eqx.filter_jit(once(lambda x, state: controller.follow(x, STEP, state)))
    for first in range(0, len(rows), hop):
        # The command stands still behind the path.
        at = np.minimum(np.arange(first, first + hop + 1 + ahead), len(rows) - 1)
        piece, state = follow(rows[at], state)
        found.append(piece[:-1])
    return np.concatenate(found)[: len(rows)]


@pytest.mark.parametrize(
    ("parts", "span"),
    [
        # Neither a whole number of cycles in a piece, nor one of rows in a cycle.
        ({"interpolation_cycle": 12e-3, "interpolation": "hold"}, (2, 2)),
        ({"interpolation_cycle": 12e-3, **FILTERS, **SERVOS}, (8, 32)),
        ({"interpolation_cycle": 7.3e-3, "interpolation": "linear", **SERVOS}, None),
        ({"interpolation_cycle": 7.3e-3, "interpolation": "hold", **FILTERS}, None),
        (FILTERS, None),
        ({"bandwidth": 2.65}, (1, 17)),
        ({"dead_time": 15e-3}, (1, 0)),
        ({}, (1, 0)),
    ],
)
def test_pieces_one_after_another_are_the_whole_path(parts, span):
    controller, count, hop = Controller(**parts), 331, 40
    noise = np.random.default_rng(0).normal(size=(count, 2))
    rows = jnp.asarray(1.0 + 5e-5 * np.cumsum(np.cumsum(noise, axis=0), axis=0))
    whole = controller.motors(rows, STEP)
    assert parts.keys() <= {"dead_time"} or np.abs(whole - rows).max() > 1e-3
    assert span is None or controller.span(STEP) == span
    np.testing.assert_allclose(in_pieces(controller, rows, hop), whole, atol=1e-13)


@pytest.mark.parametrize(
    "parts",
    [
        {"moving_average": 48e-3},
        {"interpolation_cycle": 4e-3},
        {"interpolation_cycle": 7.3e-3, "interpolation": "hold", **SERVOS},
    ],
)
def test_single_precision_is_held_on_a_long_path(parts):
    """Two minutes: times and integrals from the start lose the digits of a micrometre.

    A sum up to a row is that of the path, and a mean over some rows their difference.
    """
    count, hop = 32_000, 4000
    time = STEP * np.arange(count)
    rows = 0.8 + 0.15 * np.sin([0.86, 7.0] * time[:, None])
    rows = rows.astype(np.float32)
    wanted = jax.jit(lambda x: Controller(**parts).motors(x, STEP))(
        jnp.asarray(rows, float)
    )
    with jax.enable_x64(False):
        controller, rows = Controller(**parts), jnp.asarray(rows)
        found = jax.jit(lambda x: controller.motors(x, STEP))(rows)
        pieces = in_pieces(controller, rows, hop)
    assert found.dtype == jnp.float32
    np.testing.assert_allclose(found, wanted, rtol=0, atol=2e-6)
    np.testing.assert_allclose(pieces, found, rtol=0, atol=2e-6)


def test_changes_of_a_piece_are_those_of_the_whole_path():
    controller = Controller(interpolation_cycle=12e-3, **FILTERS, **SERVOS)
    rows, first = jnp.asarray(np.sin(9.0 * TIME)[:, None] * np.ones(2)), 57
    before, ahead = controller.span(STEP)

    @jax.jit
    def ended(rows):
        state = controller.begin(rows, STEP, before, ahead)
        return controller.follow(rows, STEP, state).state

    state = ended(rows[: first + 1 + ahead])
    change = np.random.default_rng(0).normal(size=(len(TIME), 2, 3))
    # The motors at the start know the rows up to those ahead, which stay.
    change[: first + ahead + 1] = 0
    wanted = jax.jit(lambda x: controller.motors(x, STEP))(jnp.asarray(change))
    follow = jax.jit(lambda x, state: controller.follow(x, STEP, state).motors)
    found = follow(jnp.asarray(change[first:]), state.of_changes(3))
    scale = np.abs(wanted).max()
    np.testing.assert_allclose(
        found, wanted[first : first + len(found)], atol=1e-12 * scale
    )
    assert np.abs(wanted[: first + 1]).max() < 1e-12 * scale < np.abs(found[0:5]).max()


def test_a_rest_stays_and_a_way_ends_where_it_should():
    full = Controller(
        **FILTERS,
        interpolation_cycle=12e-3,
        interpolation="hold",
        bandwidth=10.0,
        damping_ratio=0.7,
    )
    rows = jnp.asarray(1.3 + 0.2 * np.clip((TIME - 0.4) / 0.3, 0, 1)[:, None])
    found = np.asarray(full.motors(rows, STEP))[:, 0]
    assert np.allclose(found[:40], 1.3, atol=1e-12)
    assert np.isclose(found[-1], 1.5, atol=1e-9)


def test_it_is_linear_traced_and_smooth_in_its_bandwidth():
    def make(bandwidth):
        return Controller(
            moving_average=40e-3,
            interpolation_cycle=4e-3,
            low_pass=30.0,
            bandwidth=bandwidth,
            damping_ratio=0.8,
        )

    rng = np.random.default_rng(3)
    rows = jnp.asarray(np.cumsum(rng.normal(size=(60, 2, 3)), axis=0))
    run = jax.jit(lambda w, x: make(w).motors(x, STEP))
    alone = jnp.stack([run(9.0, rows[..., i]) for i in range(3)], axis=-1)
    assert np.allclose(run(9.0, rows), alone, atol=1e-12)
    mixed = rows @ jnp.asarray([1.0, -2.0, 0.5])
    assert np.allclose(run(9.0, mixed), alone @ jnp.asarray([1.0, -2.0, 0.5]))
    slope = jax.jvp(lambda w: run(w, mixed), (9.0,), (1.0,))[1]
    steps = (run(9.0 + 1e-4, mixed) - run(9.0 - 1e-4, mixed)) / 2e-4
    assert np.allclose(slope, steps, rtol=1e-5, atol=1e-6 * np.abs(steps).max())
    back = jax.grad(lambda w: jnp.sum(run(w, mixed) ** 2))(9.0)
    assert np.isclose(back, np.sum(2 * run(9.0, mixed) * slope), rtol=1e-9)


# The fast tests are compiled without the optimisation that this is about.
@pytest.mark.slow
@pytest.mark.parametrize("interpolation", ["hold", "linear"])
@pytest.mark.parametrize("servo", [{}, {"bandwidth": 10.0, "damping_ratio": 0.7}])
def test_a_compiled_run_takes_the_rows_of_an_eager_one(interpolation, servo):
    """Instants that fall on rows: compiled anew, a row and its share went apart."""
    controller = Controller(
        moving_average=30e-3,
        interpolation_cycle=12e-3,
        interpolation=interpolation,
        **servo,
    )
    step = jnp.asarray(0.0037500000000000003)
    rng = np.random.default_rng(0)
    rows = jnp.asarray(np.cumsum(rng.normal(size=(167, 6)), axis=0))
    wanted = controller.motors(rows, step)
    for found in (
        jax.jit(lambda x: controller.motors(x, step))(rows),
        jax.jit(lambda x, T: controller.motors(x, T))(rows, step),
    ):
        assert np.allclose(found, wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())


@pytest.mark.parametrize(
    "part",
    [
        *("moving_average", "shaper_frequency", "interpolation_cycle"),
        *("low_pass", "bandwidth"),
    ],
)
def test_a_part_without_extent_is_refused(part):
    make: Any = Controller
    for value in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match=f"`{part}` must be finite and above 0"):
            make(**{part: value})
    jax.jit(lambda x: make(**{part: x}).delay)(1.0)


@pytest.mark.parametrize(
    ("arguments", "fault"),
    [
        ({"bandwidth": np.array([10.0, 0.0])}, "above 0"),
        ({"bandwidth": np.ones((2, 2))}, r"\(2, 2\)"),
        ({"moving_average": [0.1, 0.2]}, r"shape \(\)"),
        ({"bandwidth": 10.0, "damping_ratio": -0.7}, "above 0"),
        ({"dead_time": -1e-3}, "at least 0"),
        ({"dead_time": "15 ms"}, "number"),
        ({"dead_time": "0.015"}, "number"),
        ({"bandwidth": np.ones(2), "damping_ratio": np.ones(3)}, "shapes"),
        ({"shaper_frequency": 9.0, "shaper_damping_ratio": 1.0}, "below 1"),
    ],
)
def test_what_no_controller_does_is_refused(arguments, fault, monkeypatch):
    # As users run it, without types looked at.
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    with pytest.raises(ValueError, match=f"`{list(arguments)[-1]}`.*{fault}"):
        Controller(**arguments)


def test_no_dead_time_is_none():
    rows = jnp.asarray(np.sin(9.0 * TIME)[:, None])
    found = Controller(dead_time=0.0).motors(rows, STEP)
    np.testing.assert_allclose(found, rows, atol=1e-15)
