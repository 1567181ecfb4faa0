"""What the table of `speed` times of diffmill, and of any program in JAX."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

import diffmill.robot as dr
from clock import compiled

STEPS = 500
BATCHES = (1, 64, 1024, 8192)
# A spring-damper law that keeps the arm near where it starts.
STIFFNESS, DAMPING, TIME_STEP = 500.0, 50.0, 1e-4

Job = tuple[Callable[[], Any], float, float]  # run, evaluations in one run, compile [s]


def jax_jobs(
    mass_matrix: Callable[..., Any] | None,
    forward: Callable[..., Any],
    count: int,
    *,
    has_gradients: bool = True,
) -> dict[str, Job]:
    """Return the jobs of one program, its functions taking one configuration.

    Args:
        mass_matrix: Of q; None leaves the row out.
        forward: Of q, v and tau.
        count: Number of joints.
        has_gradients: Whether derivatives are timed.
    """
    q = jnp.linspace(-0.5, 0.5, count)
    jobs: dict[str, Job] = {}

    def add(name: str, function: Callable[..., Any], number: float, *args: Any):
        program, seconds = compiled(function, *args)
        jobs[name] = (lambda: program(*args), number, seconds)

    def chain(function: Callable[..., Any]):
        # Each evaluation waits for the last one.
        step = lambda q, _: (q + 1e-9 * function(q), None)
        return lambda q: jax.lax.scan(step, q, length=STEPS)[0]

    def repeated(function: Callable[..., Any], repeats: int):
        rows = jax.vmap(function)
        return lambda q, v, tau: jax.lax.scan(
            lambda q, _: (q + 1e-9 * rows(q, v, tau), None), q, length=repeats
        )[0]

    if mass_matrix is not None:
        add("mass matrix", chain(lambda q: mass_matrix(q)[0]), STEPS, q)
    add("forward dynamics", chain(lambda q: forward(q, q, q)), STEPS, q)
    if has_gradients:
        jacobians = jax.jacfwd(forward, (0, 1, 2))
        add(
            "its derivatives",
            chain(lambda q: sum(J[0] for J in jacobians(q, q, q))),
            STEPS,
            q,
        )

    def rollout(q: jax.Array) -> jax.Array:
        rest = jax.lax.stop_gradient(q)

        def step(state: Any, _: None):
            q, v = state
            a = forward(q, v, STIFFNESS * (rest - q) - DAMPING * v)
            v = v + TIME_STEP * a
            return (q + TIME_STEP * v, v), None

        q, v = jax.lax.scan(step, (q, jnp.ones_like(q)), length=STEPS)[0]
        return jnp.sum(q**2) + jnp.sum(v**2)

    add("rollout, a step", rollout, STEPS, q)
    if has_gradients:
        add("with its gradient", jax.value_and_grad(rollout), STEPS, q)
    for batch in BATCHES:
        rows = jax.random.uniform(jax.random.key(batch), (3, batch, count))
        # The call from Python costs as much as hundreds of evaluations.
        repeats = max(4, 4096 // batch)
        add(f"batch of {batch}", repeated(forward, repeats), batch * repeats, *rows)
    return jobs


def our_jobs(robot: dr.Robot, algorithm: str) -> dict[str, Job]:
    """Return the jobs of diffmill."""
    forward = lambda q, v, tau: dr.forward_dynamics(
        robot, q, v, tau, algorithm=algorithm
    )
    mass = lambda q: dr.mass_matrix(robot, q)
    return jax_jobs(mass if algorithm == "crba" else None, forward, robot.joint_count)
