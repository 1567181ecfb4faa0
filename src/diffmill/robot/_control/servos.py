"""Low-pass and servos: exact for ramps, and for inputs that jump and then stand still.

A lag u - y stays right in single precision, where y does not: a step that is short
beside the servo's time would round away what it changes.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class Jumps(NamedTuple):
    """How long before the end of each step its input jumped, shape (step,) each.

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
        """Return jumps of like size, a cycle apart.

        Args:
            count: How many in each step.
            share: How much of a cycle has passed since the last of them.
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
    """Return what y' = w (u - y) makes of rows.

    Args:
        rows: The input u at some instants.
        w: Frequencies, shape (joint,) or more [rad/s].
        step: Time between the instants [s].
        begun: y at the first.
        since: How the input jumped to each of the others; None for one that is linear
            between them.
    """
    rises = jnp.diff(rows, axis=0)
    if since is None:
        late = (-jnp.expm1(-w * step) / (w * step))[None]
    else:
        # The mean of what jumps leave, to the second order of their spread.
        late = jnp.exp(-_times(since.mean, w))
        late = late * (1 + _times(since.variance, w**2) / 2)
    E = jnp.exp(-w * step)

    def advance(lag: Array, behind: Array) -> tuple[Array, Array]:
        lag = E * lag + behind
        return lag, lag

    begun = rows[0] - begun
    _, found = jax.lax.scan(advance, begun, late * rises)
    return rows - jnp.concatenate([begun[None], found])


def _times(
    since: Float[Array, " step"], w: Float[Array, "joint ..."]
) -> Float[Array, "step joint ..."]:
    """Return times in those of the joints, 1 / w."""
    return since.reshape(-1, *(1,) * w.ndim) * w[None]


class _Servo(NamedTuple):
    """State of a system of second order: the lag u - y, and v = y' / w."""

    lag: Array
    v: Array


class _Transition(NamedTuple):
    """What is left of the state of a servo; the lag that v leaves is -v_of_lag."""

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
        """Return what they make of rows, and the last v.

        Args:
            rows: As of `first_order`, as all that is not named.
            step: As there.
            begun: As there.
            speed: v at the first.
            since: As there.
        """
        rises, free = jnp.diff(rows, axis=0), self._after(self.w * step)
        if since is None:
            # Of a ramp: the integral of what a jump leaves, over the step.
            x, fallen = self.w * step, 1 - free.lag_of_lag
            lag = (2 * self.zeta * fallen + free.v_of_lag) / x
            behind = _Servo(lag[None] * rises, (fallen / x)[None] * rises)
        else:
            at = self._after(_times(since.mean, self.w))
            # The second derivative of what a jump leaves, from the servo's equation.
            half, zeta = _times(since.variance, self.w**2) / 2, self.zeta[None]
            bent = half * (2 * zeta * at.v_of_lag - at.lag_of_lag)
            turned = (4 * zeta**2 - 1) * at.v_of_lag - 2 * zeta * at.lag_of_lag
            behind = _Servo(
                (at.lag_of_lag + bent) * rises, (at.v_of_lag + half * turned) * rises
            )

        def advance(state: _Servo, behind: _Servo) -> tuple[_Servo, Array]:
            lag = free.lag_of_lag * state.lag - free.v_of_lag * state.v
            v = free.v_of_lag * state.lag + free.v_of_v * state.v
            state = _Servo(lag + behind.lag, v + behind.v)
            return state, state.lag

        begun = rows[0] - begun
        (_, ended), found = jax.lax.scan(advance, _Servo(begun, speed), behind)
        return rows - jnp.concatenate([begun[None], found]), ended

    def _after(self, x: Float[Array, "..."]) -> "_Transition":
        """Return what is left of a state after x = w t in which u stands still.

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
        # x (s - zeta), without the difference of what is alike.
        slow = jnp.exp(-jnp.where(is_over, x / (zeta + s), zeta * x))
        fast = jnp.exp(-zeta * x - jnp.where(is_over, r, 0.0))
        even = jnp.where(is_over, (slow + fast) / 2, decay * jnp.cos(r))
        odd = jnp.where(is_over, (slow - fast) / 2, decay * jnp.sin(r)) / r
        k = jnp.where(is_near, root, 0.0)
        even = jnp.where(is_near, decay * _series(k, 0), even)
        odd = x * jnp.where(is_near, decay * _series(k, 1), odd)
        return _Transition(even + zeta * odd, odd, even - zeta * odd)


def _series(k: Array, first: int) -> Array:
    """Return the sum of k^n / (2 n + first)! for a small k, cosh or sinh of its root.

    What six terms leave of k = 0.01 is less than rounding.
    """
    total = jnp.zeros_like(k)
    for n in reversed(range(6)):
        total = total * k + 1 / math.factorial(2 * n + first)
    return total
