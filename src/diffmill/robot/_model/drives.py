"""Options of drives beyond spring and damper, each switched on by its data.

Backlash: the gear carries nothing within a gap. Friction: of the joint, on its own side
of the gear; it creeps, or sticks on bristles. Motors: a mass behind the gear that a
servo holds, instead of one that stands at its command. Gear waves: a gear that does not
turn evenly. An option that is None is absent from the compiled program.
"""

import math

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

# Stretch of a spring below which its gear carries nothing, as a share of the width of a
# corner. In an axis that carries none of an arm's weight the weight cancels to
# rounding, which is below this in float32, too. For a gap of 0.1 mrad and 2e6 N m/rad
# it is 0.04 N m, which the friction of any gear holds.
_LEAST_LOAD = 1e-3


class Backlash(eqx.Module):
    """Gaps in the gears; see `Robot.with_backlash`.

    Attributes:
        gap: b [rad or m], shape (joint,).
        corner: Width of a rounded corner as a share of the gap [-], shape ().
    """

    gap: Float[Array, " joint"]
    corner: Float[Array, ""]

    def dead_zone(
        self, x: Float[Array, " joint"]
    ) -> tuple[Float[Array, " joint"], Float[Array, " joint"]]:
        """Stretch s(x) of the springs behind the gap, and its slope."""
        # symbols: b gap, w width of a corner, u depth of x in the corner
        b, w = self.gap, self.corner * self.gap
        has_gap = b > 0.0
        size, safe = jnp.abs(x), jnp.where(has_gap, w, 1.0)
        u = jnp.maximum(size - (b - w) / 2, 0.0)
        is_beyond = u > w
        s = jnp.sign(x) * jnp.where(is_beyond, size - b / 2, u**2 / (2 * safe))
        slope = jnp.where(is_beyond, 1.0, u / safe)
        return jnp.where(has_gap, s, x), jnp.where(has_gap, slope, 1.0)

    def deflection(self, y: Float[Array, " joint"]) -> Float[Array, " joint"]:
        """Stretch s^-1(y) of gears whose springs are stretched by y.

        A gear that carries next to nothing is in the middle of its gap.
        """
        # symbols: b gap, w width of a corner, y_0 and x_0 least stretch of a spring and
        # of its gear that count
        b, w = self.gap, self.corner * self.gap
        has_gap, size = b > 0.0, jnp.abs(y)
        y_0, x_0 = self._least_load(), self._least_stretch()
        is_light, in_corner = size < y_0, has_gap & (size < w / 2)
        root = jnp.sqrt(jnp.where(in_corner, 2 * w * jnp.maximum(size, y_0), 1.0))
        edge = jnp.where(in_corner, (b - w) / 2 + root, b / 2 + size)
        # A line and no jump: a cut may hold a gear anywhere in its gap, which has then
        # to be the stretch under some load.
        middle = y * x_0 / jnp.where(has_gap, y_0, 1.0)
        stretch = jnp.where(is_light, middle, jnp.sign(y) * edge)
        return jnp.where(has_gap, stretch, y)

    def static_dead_zone(
        self, x: Float[Array, " joint"]
    ) -> tuple[Float[Array, " joint"], Float[Array, " joint"]]:
        """Stretch y whose `deflection` is x, and its slope.

        That is s(x) but for gears that carry next to nothing: in their gap y rises,
        by next to nothing, so that it says where in the gap they are.
        """
        has_gap = self.gap > 0.0
        y_0, x_0 = self._least_load(), self._least_stretch()
        s, slope = self.dead_zone(x)
        rise = y_0 / jnp.where(has_gap, x_0, 1.0)
        is_light = has_gap & (jnp.abs(x) < x_0)
        return jnp.where(is_light, rise * x, s), jnp.where(is_light, rise, slope)

    def _least_load(self) -> Float[Array, " joint"]:
        """Stretch y_0 of springs below which a gear carries nothing."""
        return _LEAST_LOAD * self.corner * self.gap

    def _least_stretch(self) -> Float[Array, " joint"]:
        """Stretch x_0 of gears at that load."""
        b, w = self.gap, self.corner * self.gap
        return (b - w) / 2 + math.sqrt(2 * _LEAST_LOAD) * w


class Brake(eqx.Module):
    """Impulse of friction in a sub-step, impulse + slope dv, about a guess of dv.

    Attributes:
        impulse: At dv = 0 [N m s or N s], shape (joint,).
        slope: In dv, the change of the velocity [kg m^2 or kg], shape (joint,).
    """

    impulse: Float[Array, " joint"]
    slope: Float[Array, " joint"]


class Friction(eqx.Module):
    """Friction of the joints; see `Robot.with_friction`.

    Attributes:
        coulomb: F_c [N m or N], shape (joint,).
        viscous: F_v [N m s/rad or N s/m], shape (joint,).
        speed: v_s [rad/s or m/s], shape (joint,).
        presliding: z_s, by which a joint yields before it slides [rad or m], shape
            (joint,); None for joints that creep below v_s instead of sticking.
    """

    coulomb: Float[Array, " joint"]
    viscous: Float[Array, " joint"]
    speed: Float[Array, " joint"]
    presliding: Float[Array, " joint"] | None = None

    def torque(self, v: Float[Array, " joint"]) -> Float[Array, " joint"]:
        """Torque against a steady motion at v [N m or N], shape (joint,)."""
        return self.coulomb * jnp.tanh(v / self.speed) + self.viscous * v

    def coulomb_damping(self, v: Float[Array, " joint"]) -> Float[Array, " joint"]:
        """Damper that brakes like Coulomb friction does at v: F_c tanh / v.

        Args:
            v: Joint velocities [rad/s or m/s], shape (joint,).

        Returns:
            Dampers [N m s/rad or N s/m], shape (joint,).

        **Differentiability**: smooth but for rounding where tanh is replaced by its
        slope.
        """
        x = v / self.speed
        is_slow = jnp.abs(x) < 1e-4
        safe = jnp.where(is_slow, 1.0, x)
        share = jnp.where(is_slow, 1.0, jnp.tanh(safe) / safe)
        return self.coulomb / self.speed * share

    def steady_bristles(self, v: Float[Array, " joint"]) -> Array | None:
        """Bristles z in a steady motion at v [rad or m], shape (joint,).

        None for friction without any.
        """
        if self.presliding is None:
            return None
        return self.presliding * jnp.tanh(v / self.speed)

    def moved_bristles(
        self, z: Float[Array, " joint"], travel: Float[Array, " joint"]
    ) -> Float[Array, " joint"]:
        """Bristles after a way of the joints: z + travel, at most z_s to either side.

        Args:
            z: Before [rad or m], shape (joint,).
            travel: Way of the joints [rad or m], shape (joint,).
        """
        assert self.presliding is not None
        return jnp.clip(z + travel, -self.presliding, self.presliding)

    def bristle_stiffness(self) -> Float[Array, " joint"]:
        """Stiffness F_c / z_s of a joint that sticks [N m/rad or N/m]; 0 without."""
        assert self.presliding is not None
        has_any = self.presliding > 0.0
        return jnp.where(
            has_any, self.coulomb / jnp.where(has_any, self.presliding, 1.0), 0.0
        )

    def brake(
        self,
        z: Float[Array, " joint"] | None,
        v: Float[Array, " joint"],
        dv: Float[Array, " joint"],
        step: Float[Array, ""],
        ahead: Float[Array, ""] | Float[Array, " joint"],
    ) -> Brake:
        """Impulse of friction in a sub-step.

        Args:
            z: Bristles at its start [rad or m], shape (joint,); None without any.
            v: Velocities at its start [rad/s or m/s], shape (joint,).
            dv: Guess of their change in it [rad/s or m/s], shape (joint,).
            step: Its length h [s].
            ahead: s, from its start to where forces act [s]; may differ by joint.

        Returns:
            The impulse. A smooth law brakes as fast as the joint moves at the end of
            the sub-step. Bristles push by their mean over the way.
        """
        h, s = step, ahead
        impulse, slope = h * self.viscous * v, s * self.viscous
        if z is None:
            c = h * self.coulomb_damping(v + dv)
            return Brake(impulse + c * v, slope + c)
        elastic, travel = h * self.bristle_stiffness(), h * v + s * dv
        end = self.moved_bristles(z, travel)
        sticks = end == z + travel
        # The share of the way on which bristles still stretch that then slide.
        share = (end - z) / jnp.where(sticks, 1.0, travel)
        sliding = elastic * (end - share * (end - z) / 2)
        held = elastic * (z + h * v / 2)
        return Brake(
            impulse + jnp.where(sticks, held, sliding),
            slope + jnp.where(sticks, elastic * s / 2, 0.0),
        )

    def torque_and_rate(
        self, z: Float[Array, " joint"] | None, v: Float[Array, " joint"]
    ) -> tuple[Float[Array, " joint"], Float[Array, " joint"] | None]:
        """Torque against the motion [N m or N], and the rate of the bristles."""
        if z is None or self.presliding is None:
            return self.torque(v), None
        is_stretched = (jnp.abs(z) >= self.presliding) & (z * v > 0)
        # A rule with steps of its own may bring a bristle beyond its end.
        held = self.moved_bristles(z, jnp.zeros_like(z))
        torque = self.bristle_stiffness() * held + self.viscous * v
        return torque, jnp.where(is_stretched, 0.0, v)


class Motors(eqx.Module):
    """Masses behind the gears, held by servos; see `Robot.with_motors`.

    Attributes:
        inertia: J_m [kg m^2 or kg], shape (joint,).
        stiffness: K_s [N m/rad or N/m], shape (joint,).
        damping: D_s [N m s/rad or N s/m], shape (joint,).
    """

    inertia: Float[Array, " joint"]
    stiffness: Float[Array, " joint"]
    damping: Float[Array, " joint"]


class GearWaves(eqx.Module):
    """Transmission errors that repeat as a joint turns; see `LinkErrors`.

        w(q) = s_1 sin k q + c_1 cos k q + s_2 sin 2 k q + c_2 cos 2 k q

    Attributes:
        amplitudes: s_1, c_1, s_2, c_2 [rad], shape (joint, 4).
        per_turn: k, the waves of a turn of the joint [-], shape ().
    """

    amplitudes: Float[Array, "joint 4"]
    per_turn: Float[Array, ""]

    def error(self, motor: Float[Array, " joint"]) -> Float[Array, " joint"]:
        """Error w of the joint behind a motor position [rad], shape (joint,)."""
        angle = self.per_turn * motor
        waves = [jnp.sin(angle), jnp.cos(angle), jnp.sin(2 * angle), jnp.cos(2 * angle)]
        return jnp.sum(self.amplitudes * jnp.stack(waves, axis=-1), axis=-1)


class GearTorque(eqx.Module):
    """Torque of the gears.

    Attributes:
        torque: tau [N m or N], shape (joint,).
        stiffness: Its slope in x, K s'(x) [N m/rad or N/m], shape (joint,).
        damping: Its slope in x', D s'(x) [N m s/rad or N s/m], shape (joint,).
    """

    torque: Float[Array, " joint"]
    stiffness: Float[Array, " joint"]
    damping: Float[Array, " joint"]
