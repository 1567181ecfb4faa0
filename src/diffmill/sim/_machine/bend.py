"""How an arm without inertia bends in a tooth period, and its balance with gaps.

Without gaps the joints are a smooth function of the mean load, and so is the tip. A
gear with a gap crosses it as its torque changes sign: as a function of the load the
joint jumps. Its balance is therefore looked for in the joints q, where the excess

    r(q) = s(theta - q - tau / K_s) - tau / K,   tau = G - J^T F(q),

is as smooth as the force: s has no jump, and a joint that the cut holds inside the gap,
with hardly any torque, is in balance as any other.

With W = -r'(q) Newton's step is W^-1 r. It looks for any balance, also one that the arm
would leave at once. Where the symmetric part of W has a negative eigenvalue, the cut
drags a joint through its gap faster than anything holds it back, and the step goes
against the cut; W less twice that eigenvalue lets it go as far with the cut. So the
side of a gap is found on which the cut holds the joint: in 10 to 20 steps if it is
another one than before, else in 2 to 4.

No balance is found, as a rule, where the tool stands: edges that only plough push
against the motion, whatever way that is, and hold the tool while its gears go through
their gaps. A force that turns round within nanometres tells no step where to go.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ...robot import Robot
from ...workpiece import Pose
from .coupled_period import along

# Step at which the search ends [rad or m], some nanometres at the tip, or so many eps:
# in float32 a joint is known no better.
_TOLERANCE, _ROUNDINGS = 1e-9, 32
# Steps at most, and Newton's own to begin with: on the same side of all gaps they are
# enough.
_MOST_STEPS, _PLAIN_STEPS = 50, 2


class StaticEquilibrium(eqx.Module):
    """The arm at one instant: joints, pose in `work`, and load on the tool."""

    q: Float[Array, " joint"]
    pose: Pose
    load: Float[Array, " load"]


class StaticDeflection(eqx.Module):
    """The arm in one period, whose end follows the mean load.

    Attributes:
        robot: The robot.
        start: Tip at the start [m], shape (3,).
        near: Joints near to those of the end [rad or m], shape (joint,).
        motors: At the end [rad or m], shape (joint,).
        pose: At the near joints.
        jacobian: There.
        gravity: Torques of gravity there [N m or N], shape (joint,).
    """

    robot: Robot
    start: Float[Array, " 3"]
    near: Float[Array, " joint"]
    motors: Float[Array, " joint"]
    pose: Pose
    jacobian: Float[Array, "load joint"]
    gravity: Float[Array, " joint"]

    def joints(self, load: Float[Array, " load"]) -> Float[Array, " joint"]:
        """Return the joints at the end under a load [rad or m]."""
        return self.motors - self.robot.drive_deflection(self.torque(load))

    def torque(self, load: Float[Array, " load"]) -> Float[Array, " joint"]:
        """Torque that the gears carry under a load [N m or N]."""
        return self.gravity - self.jacobian.T @ load

    def balance(self, load: Float[Array, " load"]) -> StaticEquilibrium:
        """Return the arm at the end under a load."""
        return self.balance_at(self.joints(load), load)

    def balance_at(
        self, q: Float[Array, " joint"], load: Float[Array, " load"]
    ) -> StaticEquilibrium:
        """Return the arm at the end with given joints."""
        return StaticEquilibrium(q, Pose(self.tip(q), self.pose.axis), load)

    def poses(
        self, load: Float[Array, " load"], places: Float[Array, " place"]
    ) -> Pose:
        """Return the poses under a load, at some places of the way."""
        shares, end = places[:, None], self.balance(load).pose.tip
        return self._between(shares, end)

    def reached(self, end: StaticEquilibrium, places: Float[Array, " place"]) -> Pose:
        """Return the poses on the way to a balance, at some places of it."""
        if self.robot.backlash is None:
            return self.poses(end.load, places)
        # In a gap a joint is anywhere under nearly one load.
        return self.poses_to(end.pose.tip, places)

    def expected(
        self, load: Float[Array, " load"], places: Float[Array, " place"]
    ) -> Pose:
        """Return the poses if a load, or a joint in its gap, were to stay."""
        if self.robot.backlash is None:
            return self.poses(load, places)
        return self.poses_to(self.pose.tip, places)

    def poses_to(self, tip: Float[Array, " 3"], places: Float[Array, " place"]) -> Pose:
        """Return the poses on the way to a tip, at some places of it."""
        return self._between(places[:, None], tip)

    def _between(
        self, shares: Float[Array, "place 1"], tip: Float[Array, " 3"]
    ) -> Pose:
        tips = self.start[None] * (1 - shares) + tip[None] * shares
        return along(self.pose, tips)

    def tip(self, q: Float[Array, " joint"]) -> Float[Array, " 3"]:
        """Return the tip at the end for joints [m]."""
        return self.pose.tip + self.jacobian[:3] @ (q - self.near)


# Mean load of a period, shape (load,), from the tip at its end [m], shape (3,).
_LoadOfTip = Callable[[Float[Array, " 3"]], Float[Array, " load"]]


def balance_with_gaps(bend: StaticDeflection, load_of: _LoadOfTip) -> StaticEquilibrium:
    """Return the arm at the end of a period, whose gears have gaps.

    Args:
        bend: How the arm bends in the period.
        load_of: Mean load of the period, from the tip at its end.

    Returns:
        The balance; NaN if none was found.

    **Differentiability**: that of the balance, not of the steps to it.
    """
    dtype = bend.near.dtype
    limit = max(_TOLERANCE, _ROUNDINGS * float(jnp.finfo(dtype).eps))
    ways, eye = jnp.eye(3, dtype=dtype), jnp.eye(bend.near.size, dtype=dtype)

    def excess(q: Array) -> Array:
        return _Excess.of(bend, q, load_of(bend.tip(q))).springs

    def goes_on(search):
        _, size, count = search
        # NaN is no size to go on from.
        return (size > limit) & (count < _MOST_STEPS)

    def step(search):
        q, _, count = search
        # One pass gives value and slope: the load beside each column is the same.
        value_and_slope = lambda way: jax.jvp(load_of, (bend.tip(q),), (way,))
        loads, columns = jax.vmap(value_and_slope)(ways)
        here = _Excess.of(bend, q, loads[0])
        move = here.step(bend, columns.T, count < _PLAIN_STEPS)
        return q + move, jnp.max(jnp.abs(move)), count + 1

    def search(_: Callable[..., Array], near: Array) -> Array:
        first = near, jnp.full((), jnp.inf, dtype), jnp.zeros((), jnp.int32)
        q, size, _steps = jax.lax.while_loop(goes_on, step, first)
        return jnp.where(size <= limit, q, jnp.nan)

    solve = lambda slope, y: jnp.linalg.solve(jax.vmap(slope)(eye).T, y)
    q = jax.lax.custom_root(excess, bend.near, search, solve)
    return bend.balance_at(q, load_of(bend.tip(q)))


class _Excess(NamedTuple):
    """Stretch of the springs beyond that of their torques.

    Attributes:
        springs: The excess [rad or m], shape (joint,).
        slope: Of s where the gears are [-], shape (joint,).
    """

    springs: Float[Array, " joint"]
    slope: Float[Array, " joint"]

    @classmethod
    def of(
        cls,
        bend: StaticDeflection,
        q: Float[Array, " joint"],
        load: Float[Array, " load"],
    ) -> "_Excess":
        """Return the excess for joints and a load."""
        robot, tau = bend.robot, bend.torque(load)
        assert robot.backlash is not None
        stretch = bend.motors - q - robot.servo_deflection(tau)
        y, slope = robot.backlash.static_dead_zone(stretch)
        return cls(y - tau / robot.joint_stiffness, slope)

    def step(
        self,
        bend: StaticDeflection,
        cut: Float[Array, "load 3"],
        is_plain: Bool[Array, ""],
    ) -> Float[Array, " joint"]:
        """Return the step of the joints towards a balance [rad or m].

        Args:
            bend: How the arm bends in the period.
            cut: Slopes of the load in the tip [N/m], [N].
            is_plain: Whether it is Newton's, wherever that goes.
        """
        # symbols: r excess, S slope of s, N of the torques, C compliance of springs
        # and, as far as gears carry, of servos
        r, S, robot, J = self.springs, self.slope, bend.robot, bend.jacobian
        assert robot.backlash is not None
        N = -J.T @ cut @ J[:3]
        C = 1 / robot.joint_stiffness + S * robot.servo_deflection(jnp.ones_like(r))
        W = jnp.diag(S) + C[:, None] * N
        # With the eigenvalues of W, and as symmetric as the cut is.
        root = jnp.sqrt(C)
        even = jnp.diag(S) + root[:, None] * (N + N.T) / 2 * root[None]
        least = jnp.linalg.eigvalsh(even)[0]
        shift = jnp.where(is_plain, 0.0, jnp.maximum(-2 * least, 0.0))
        move = jnp.linalg.solve(W + shift * jnp.eye(r.size, dtype=r.dtype), r)
        # In its gap a joint may be as soft as nothing: it stays near, all the same.
        b, size = robot.backlash.gap, jnp.abs(move)
        reach = jnp.where((b > 0.0) & (size > 0.0), b + 2 * jnp.abs(r), jnp.inf)
        share = jnp.min(reach / jnp.where(size > 0.0, size, 1.0))
        return move * jnp.minimum(share, 1.0)
