"""The arm alone: it swings on its springs, and cuts nothing.

The integrators of the coupled simulation, to see what they do to an oscillation:
their order, the damping that they add and the energy that they keep.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from ..._types import RealScalarLike
from ...robot import ArmTerms, Robot
from ._integrator.base import AbstractIntegrator, ArmState, MotorCommand
from ._integrator.midpoint import Midpoint
from .midpoint_terms import HoldSpan, middle_terms


class FreeMotion(eqx.Module):
    """A motion of the arm.

    Attributes:
        time: [s], shape (row,).
        joint_positions: [rad or m], shape (row, joint).
        joint_velocities: [rad/s or m/s], shape (row, joint).
    """

    time: Float[Array, " row"]
    joint_positions: Float[Array, "row joint"]
    joint_velocities: Float[Array, "row joint"]


def free_motion(
    robot: Robot,
    start: ArmState,
    motor_positions: Float[Array, " joint"],
    time_step: RealScalarLike,
    rows: int,
    integrator: AbstractIntegrator | None = None,
    *,
    held: int = 1,
) -> FreeMotion:
    """Let the arm swing with its motors at rest.

    Args:
        robot: The robot.
        start: Where it begins; motors with a mass that it does not place begin at
            rest at theta, and bristles unstretched.
        motor_positions: theta [rad or m], shape (joint,); 0 for virtual joints.
        time_step: Step h [s], shape ().
        rows: Rows of the result after the first.
        integrator: The rule of a step; `Midpoint()` if not given.
        held: Steps per row, for which the terms of its middle hold, as in the coupled
            simulation with this many sub-steps.

    Returns:
        The motion, its start in row 0.

    Differentiability: smooth.
    """
    rule = Midpoint() if integrator is None else integrator
    if robot.motors is not None and start.theta is None:
        still = jnp.zeros_like(motor_positions)
        start = ArmState(start.q, start.v, motor_positions, still, start.bristles)
    if robot.friction is not None and start.bristles is None:
        bristles = robot.friction.steady_bristles(jnp.zeros_like(start.v))
        start = dataclasses.replace(start, bristles=bristles)
    h = jnp.asarray(time_step, start.q.dtype)
    command = MotorCommand(motor_positions, jnp.zeros_like(motor_positions))
    rest = jnp.zeros_like(start.q)
    span = HoldSpan(h * held, held)

    def step(prepared: PyTree, state: ArmState) -> ArmState:
        return rule.step(robot, prepared, state, command, rest, h)

    def row(state: ArmState, _: None) -> tuple[ArmState, ArmState]:
        terms = ArmTerms.of_state(robot, state.q, state.v)
        terms = middle_terms(robot, rule, terms, state, command, span)
        prepared = rule.begin(robot, terms, h)
        after, _ = jax.lax.scan(
            lambda s, _: (step(prepared, s), None), state, length=held
        )
        return after, after

    _, states = jax.lax.scan(row, start, length=rows)
    states = jax.tree.map(lambda x, y: jnp.concatenate([x[None], y]), start, states)
    time = jnp.arange(rows + 1, dtype=h.dtype) * span.duration
    return FreeMotion(time, states.q, states.v)
