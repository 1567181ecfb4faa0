"""Low-pass and servos: exact for ramps, and for inputs that jump and then stand still.

A lag u - y stays right in single precision, where y does not: a step that is short
beside the servo's time would lose its change in the rounding.
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class Jumps(NamedTuple):
    """Times from the jumps of the input to the end of each step, shape (step,) each.

    Attributes:
        mean: Mean time since the jumps of the step [s].
        variance: Their variance [s^2]; 0 for one jump.
    """

    mean: Float[Array, " step"]
    variance: Float[Array, " step"]

    @staticmethod
    def of_cycles(
        count: Float[Array, " step"], share: Float[Array, " step"], cycle: Array
    ) -> "Jumps":
        """Jumps of like size, a cycle apart.

        Args:
            count: Number of jumps in each step.
            share: Share of a cycle that has passed since the last of them.
            cycle: The cycle [s].
        """
        count = jnp.maximum(count, 1)
        mean = jnp.maximum(share + (count - 1) / 2, 0) * cycle
        return Jumps(mean, (count**2 - 1) / 12 * cycle**2)


def first_order(
    rows: Float[Array, "instant joint ..."],
    w: Float[Array, "joint ..."],
    step: Float[Array, ""],
    begun: Float[Array, "joint ..."],
    since: Jumps | None,
) -> Float[Array, "instant joint ..."]:
    """Response y of lags of first order, y' = w (u - y), to an input u.

    Args:
        rows: The input u at some instants.
        w: Frequencies, shape (joint,) or more [rad/s].
        step: Time between the instants [s].
        begun: y at the first.
        since: Jumps of the input to each of the others; None for one that is linear
            between them.
    """
    rises = jnp.diff(rows, axis=0)
    if since is None:
        late = (-jnp.expm1(-w * step) / (w * step))[None]
    else:
        # Mean lag that the jumps leave, to the second order of their spread.
        late = jnp.exp(-_times(since.mean, w))
        late = late * (1 + _times(since.variance, w**2) / 2)
    E = jnp.exp(-w * step)

    def advance(lag: Array, behind: Array) -> tuple[Array, Array]:
        lag = E * lag + behind
        return lag, lag

    first_lag = rows[0] - begun
    _, lags = jax.lax.scan(advance, first_lag, late * rises)
    return rows - jnp.concatenate([first_lag[None], lags])


def _times(
    since: Float[Array, " step"], w: Float[Array, "joint ..."]
) -> Float[Array, "step joint ..."]:
    """Times in units of the joints' own, 1 / w [-]."""
    return since.reshape(-1, *(1,) * w.ndim) * w[None]


class _Transition(NamedTuple):
    """State of a servo, lag u - y and v = y' / w, after a time without a new input.

    Attributes:
        lag_of_lag: Lag left of a unit lag.
        v_of_lag: v left of a unit lag; a unit v leaves the lag -v_of_lag.
        v_of_v: v left of a unit v.
    """

    lag_of_lag: Array
    v_of_lag: Array
    v_of_v: Array


class SecondOrder(NamedTuple):
    """Servos y'' + 2 zeta w y' + w^2 y = w^2 u, one for each joint.

    Attributes:
        w: Their frequencies [rad/s], shape (joint,) or more.
        zeta: Their damping ratios [-], same shape.
    """

    w: Float[Array, "joint ..."]
    zeta: Float[Array, "joint ..."]

    def follow(
        self,
        rows: Float[Array, "instant joint ..."],
        step: Float[Array, ""],
        begun: Float[Array, "joint ..."],
        speed: Float[Array, "joint ..."],
        since: Jumps | None,
    ) -> tuple[Float[Array, "instant joint ..."], Float[Array, "joint ..."]]:
        """Response y of the servos to an input u, and the last v = y' / w.

        Args:
            rows: The input u at some instants.
            step: Time between the instants [s].
            begun: y at the first.
            speed: v at the first.
            since: Jumps of the input to each of the others; None for one that is
                linear between them.
        """
        rises, free = jnp.diff(rows, axis=0), self._after(self.w * step)
        if since is None:
            # Of a ramp: the integral over the step of the state that a jump leaves.
            x, fallen = self.w * step, 1 - free.lag_of_lag
            lag = (2 * self.zeta * fallen + free.v_of_lag) / x
            added = lag[None] * rises, (fallen / x)[None] * rises
        else:
            at = self._after(_times(since.mean, self.w))
            # Second derivative of the state that a jump leaves, from its equation.
            half, zeta = _times(since.variance, self.w**2) / 2, self.zeta[None]
            bent = half * (2 * zeta * at.v_of_lag - at.lag_of_lag)
            turned = (4 * zeta**2 - 1) * at.v_of_lag - 2 * zeta * at.lag_of_lag
            added = (
                (at.lag_of_lag + bent) * rises,
                (at.v_of_lag + half * turned) * rises,
            )

        def advance(state: Any, added: Any) -> tuple[Any, Array]:
            lag, v = state
            lag, v = (
                free.lag_of_lag * lag - free.v_of_lag * v + added[0],
                free.v_of_lag * lag + free.v_of_v * v + added[1],
            )
            return (lag, v), lag

        first_lag = rows[0] - begun
        (_, last_speed), lags = jax.lax.scan(advance, (first_lag, speed), added)
        return rows - jnp.concatenate([first_lag[None], lags]), last_speed

    def _after(self, x: Float[Array, "..."]) -> _Transition:
        """Transition of the state over x = w t, in which u rests.

        The exponential of [[0, -1], [1, -2 zeta]] x, in closed form.
        """
        zeta = self.zeta.reshape(*(1,) * (x.ndim - self.zeta.ndim), *self.zeta.shape)
        beyond = jnp.broadcast_to(zeta**2 - 1, x.shape)
        root = beyond * x**2
        is_near = jnp.abs(root) < 1e-2
        # Away from the critical damping, where roots have no derivative.
        away = jnp.where(is_near, 1.0, beyond)
        is_over, s = away > 0, jnp.sqrt(jnp.abs(away))
        r = jnp.where(is_near, 1.0, s * x)
        decay = jnp.exp(-zeta * x)
        # x (s - zeta), without the difference of two like numbers.
        slow = jnp.exp(-jnp.where(is_over, x / (zeta + s), zeta * x))
        fast = jnp.exp(-zeta * x - jnp.where(is_over, r, 0.0))
        even = jnp.where(is_over, (slow + fast) / 2, decay * jnp.cos(r))
        odd = jnp.where(is_over, (slow - fast) / 2, decay * jnp.sin(r)) / r
        k = jnp.where(is_near, root, 0.0)
        even = jnp.where(is_near, decay * _series(k, 0), even)
        odd = x * jnp.where(is_near, decay * _series(k, 1), odd)
        return _Transition(even + zeta * odd, odd, even - zeta * odd)


def _series(k: Array, first: int) -> Array:
    """Sum of k^n / (2 n + first)! for a small k, cosh or sinh of its root.

    The error of six terms at k = 0.01 is less than rounding.
    """
    total = jnp.zeros_like(k)
    for n in reversed(range(6)):
        total = total * k + 1 / math.factorial(2 * n + first)
    return total
