"""One tooth period as a linear map of the arm's state and the tips before.

The slopes of the integrator's own step and of the library's own force, sub-step by
sub-step as the simulation takes them.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from ..robot import Robot, arm_terms
from ._force_slopes import ForceSlopes
from ._period import substep_middles
from ._plan import ProcessPlan
from ._stepping import AbstractIntegrator, ArmState, MotorCommand


@eqx.filter_jit
def period_maps(
    robot: Robot,
    T_base_work: Float[Array, "4 4"],
    integrator: AbstractIntegrator,
    tooth_period: Float[Array, ""],
    plan: ProcessPlan,
    slopes: ForceSlopes,
    motors: tuple[Float[Array, "row joint"], Float[Array, "row joint"]],
    joints: tuple[Float[Array, "row joint"], Float[Array, "row joint"]],
    force: Float[Array, "row 3"],
) -> Float[Array, "row state state"]:
    """Return the linear maps of the tooth periods before some rows."""
    # symbols: h sub-step, P, G slopes of a sub-step in state and load, C of the tip
    h = tooth_period / plan.substeps
    first = substep_middles(plan, h.dtype)[0] * tooth_period

    def one(
        slopes: ForceSlopes,
        motors: tuple[Array, Array],
        joints: tuple[Array, Array],
        force: Float[Array, " 3"],
    ) -> Float[Array, "state state"]:
        rate = (motors[1] - motors[0]) / tooth_period
        q, v = joints[0], (joints[1] - joints[0]) / tooth_period
        state = ArmState(q, v)
        if robot.motors is not None:
            state = ArmState(q, v, motors[0], rate)
        terms = arm_terms(robot, q + tooth_period / 2 * v, v)
        J = T_base_work[:3, :3].T @ terms.jacobian[:3]
        begun = integrator.begin(robot, terms, h)
        command = MotorCommand(motors[0] + first * rate, rate)
        flat, unravel = ravel_pytree(state)

        def step(x: Float[Array, " state"], F: Float[Array, " 3"]) -> Array:
            load = J.T @ F
            end = integrator.step(robot, begun, unravel(x), command, load, h)
            return ravel_pytree(end)[0]

        def tip(x: Float[Array, " state"]) -> Float[Array, " 3"]:
            state = unravel(x)
            return J @ (state.q + h / 2 * state.v)

        P, G = jax.jacfwd(step, argnums=(0, 1))(flat, force)
        return _monodromy(P, G, jax.jacfwd(tip)(flat), slopes)

    return jax.vmap(one)(slopes, motors, joints, force)


def _monodromy(
    P: Float[Array, "state state"],
    G: Float[Array, "state 3"],
    C: Float[Array, "3 state"],
    slopes: ForceSlopes,
) -> Float[Array, "all all"]:
    """Return the map of arm state and earlier tips over one tooth period."""
    substeps, teeth = slopes.before.shape[:2]
    count = P.shape[0]
    start = jnp.eye(count + teeth * substeps * 3, dtype=P.dtype)
    earlier = start[count:].reshape(teeth, substeps, 3, -1)

    def substep(
        X: Float[Array, "state all"], x: tuple[Array, Array, Array]
    ) -> tuple[Float[Array, "state all"], Float[Array, "3 all"]]:
        now, before, tips = x
        tip = C @ X
        force = now @ tip + jnp.einsum("jab,jbn->an", before, tips)
        return P @ X + G @ force, tip

    xs = (slopes.now, slopes.before, jnp.swapaxes(earlier, 0, 1))
    end, tips = jax.lax.scan(substep, start[:count], xs)
    kept = jnp.concatenate([tips[None], earlier[:-1]])
    return jnp.concatenate([end, kept.reshape(start.shape[0] - count, -1)])


def growth(
    maps: Float[np.ndarray, "row state state"],
    tooth_period: float,
    sizes: tuple[int, int],
) -> tuple[
    Float[np.ndarray, " row"], Float[np.ndarray, " row"], Float[np.ndarray, " row"]
]:
    """Return radius, frequency and apparent frequency of the strongest vibrations."""
    teeth, substeps = sizes
    values, vectors = np.linalg.eig(maps)
    largest = np.argmax(np.abs(values), axis=1)
    at = np.arange(len(maps))
    value, vector = values[at, largest], vectors[at, :, largest]
    turn = np.angle(value)
    # Within a period the vibration is exp(s t) times a periodic motion, whose strongest
    # harmonic tells how many whole turns the eigenvalue hides.
    tips = vector[:, -3 * teeth * substeps :].reshape(-1, teeth, substeps, 3)[:, 0]
    share = (np.arange(substeps) + 0.5) / substeps
    rate = np.log(np.maximum(np.abs(value), 1e-30)) + 1j * turn
    periodic = tips * np.exp(-rate[:, None] * share[None])[:, :, None]
    power = np.sum(np.abs(np.fft.fft(periodic, axis=1)) ** 2, axis=2)
    harmonic = np.fft.fftfreq(substeps, 1 / substeps)[np.argmax(power, axis=1)]
    hertz = 1 / (2 * np.pi * tooth_period)
    frequency = np.abs(turn + 2 * np.pi * harmonic) * hertz
    return np.abs(value), frequency, np.abs(turn) * hertz
