"""Spring, reversal, backlash, friction and delay of one joint.

Three regressions share the bristle s(q) of `joint_motion`, whose travel z makes their
residuals least. The deflection over the torque gives the spring K: friction of the
motor is in the torque and not in the spring, so that h is free. The deflection at equal
load gives the reversal r and the delay T, the torque itself all friction.
"""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from .coloured_fit import ColouredFit, fit_coloured
from .joint_motion import JointMotion, offsets
from .repeating_error import RepeatingError

# Travels z that are tried first, and the step of ln z of a derivative.
_TRIED, _STEP, _SHORTEST = 10, 0.05, 1e-3
# Rounds of fits: the delay is taken out exactly by shifting the link in time.
_ROUNDS = 3
# A load coefficient is a torque or a deflection of this many times its scatter at most.
_PRIOR_SPREAD = 3.0
# Share of the rows at which a load must pull either way for a gap to be seen, and of a
# column that the others may explain.
_LEAST_SIDE, _MOST_EXPLAINED = 0.02, 0.85
_STUDENT = 1.96
# A spring is known if it is so many standard errors.
_LEAST_RATIO = 3.0
# Steps of ln z behind the best travel that is tried, their length, and an error
# beyond which nothing is known.
_NEWTON_STEPS, _LONGEST_STEP, _SURELY = 4, 0.5, 10.0


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A number with its standard error.

    Attributes:
        value: The number; NaN if it is not identifiable.
        error: Its standard error.
    """

    value: float
    error: float

    @property
    def interval(self) -> tuple[float, float]:
        """Ends of its interval of 95 %."""
        half = _STUDENT * self.error
        return self.value - half, self.value + half

    def __mul__(self, other: "Estimate") -> "Estimate":
        size = math.hypot(self.error * other.value, self.value * other.error)
        return Estimate(self.value * other.value, size)


UNKNOWN = Estimate(math.nan, math.inf)


@dataclasses.dataclass(frozen=True)
class JointReversal:
    """Drive of a joint.

    Attributes:
        compliance: 1 / K [rad/(N m)].
        reversal: r, by which the link stays behind the motor in either direction at
            equal load [rad]: half of the width of the hysteresis.
        backlash: b [rad]; unknown if the load never changes its side, or does so with
            the motion alone: r then holds half of it.
        presliding: z, over which the friction builds up [rad].
        presliding_interval: Ends of its interval of 95 % [rad], 0 or
            infinite where the record shows none.
        delay: T of the link's encoder [s], with viscous friction of the link over K.
        coulomb: F_c of motor and link [N m].
        viscous: F_v of motor and link [N m s/rad].
        load_sides: Share of the rows at which the spring pulls to its rarer side.
        backlash_explained: Share of the column of the gap that the others explain.
        independent: Independent samples of the deflection.
        fitted: Deflection over the torque, as fitted.
    """

    compliance: Estimate
    reversal: Estimate
    backlash: Estimate
    presliding: float
    presliding_interval: tuple[float, float]
    delay: Estimate
    coulomb: Estimate
    viscous: Estimate
    load_sides: float
    backlash_explained: float
    independent: float
    fitted: ColouredFit

    @property
    def sees_both_flanks(self) -> bool:
        """True if the spring pulls to either side, so that both flanks carry."""
        return self.load_sides >= _LEAST_SIDE

    @property
    def stiffness_interval(self) -> tuple[float, float]:
        """Ends of the interval of 95 % of K [N m/rad]; infinite without an upper."""
        low, high = self.compliance.interval
        return 1.0 / high if high > 0 else 0.0, 1.0 / low if low > 0 else math.inf

    @property
    def stiffness(self) -> Estimate:
        """K [N m/rad]; unknown if its error is more than a third of it."""
        c, error = self.compliance.value, self.compliance.error
        if c < _LEAST_RATIO * error:
            return UNKNOWN
        return Estimate(1.0 / c, error / c**2)

    @classmethod
    def of(
        cls, motions: Sequence[JointMotion], repeating: RepeatingError | None
    ) -> "JointReversal":
        """Drive that suits all records.

        Args:
            motions: The joint in every record.
            repeating: Prior of the error that repeats over the position; None for none.
        """
        longest = motions[0].longest_presliding
        tried = np.geomspace(_SHORTEST * longest, longest, _TRIED)
        equations = JointEquations(motions, repeating)
        delay, z = 0.0, float(longest)
        for _ in range(_ROUNDS):
            costs = [equations.cost(float(one), delay) for one in tried]
            z = float(tried[int(np.argmin(costs))])
            for _ in range(_NEWTON_STEPS):
                step = equations.travel_step(z, delay).value
                step = min(max(step, -_LONGEST_STEP), _LONGEST_STEP)
                z = float(np.clip(z * math.exp(step), tried[0], longest))
            deflected, torque = equations.at_equal_load(z, delay), equations.torque(z)
            equations.weights = deflected.independent, torque.independent
            delay += float(deflected.x[1])
            equations.set_gap(z, delay)
        return equations.solved(z, delay)


@dataclasses.dataclass
class JointEquations:
    """Regressions of a joint.

    Attributes:
        motions: The joint in every record.
        repeating: Prior of the error that repeats; None for none.
        gap: Column of the backlash of every record; None without.
        load_sides: Share of the rows on the rarer side of the load.
        explained: Share of the column of the gap that the other columns explain.
        weights: Independent samples of the deflection and of the torque.
    """

    motions: Sequence[JointMotion]
    repeating: RepeatingError | None
    gap: list[np.ndarray] | None = None
    load_sides: float = 0.0
    explained: float = 1.0
    weights: tuple[float, float] = (1.0, 1.0)

    def at_equal_load(
        self, z: float, delay: float, *, slope: float = 0.0
    ) -> ColouredFit:
        """Fit of the deflection without the torque: -r, T_v, beta, gap, load, offset.

        A `slope` beside zero adds the column of ln z behind the third.
        """
        values = [one.deflection(delay) for one in self.motions]
        return self._loaded(z, values, slope, is_torque=False)

    def torque(self, z: float, *, slope: float = 0.0) -> ColouredFit:
        """Fit of the torque: F_c, F_v, J, load, offset."""
        values = [one.torque for one in self.motions]
        return self._loaded(z, values, slope, is_torque=True)

    def _loaded(
        self,
        z: float,
        values: list[np.ndarray],
        slope: float,
        *,
        is_torque: bool,
    ) -> ColouredFit:
        """Fit over the motion and the load."""
        columns, count = [], 0
        for place, (one, constant) in enumerate(
            zip(self.motions, offsets(self.motions), strict=True)
        ):
            late = one.velocity if is_torque else -one.velocity
            own = [one.bristle(z), late, one.acceleration]
            if slope:
                own.append(slope * self._slope(one, z))
            if self.gap is not None and not is_torque:
                own.append(self.gap[place])
            count = len(own)
            columns.append(np.column_stack([*own, one.load, constant]))
        precision = np.zeros(columns[0].shape[1])
        scatter = np.std(np.concatenate([v - v.mean() for v in values]))
        load = slice(count, count + self.motions[0].load.shape[1])
        precision[load] = (_PRIOR_SPREAD * scatter) ** -2.0
        return fit_coloured(columns, values, precision)

    @staticmethod
    def _slope(one: JointMotion, z: float) -> Float[np.ndarray, " used"]:
        """Derivative of the bristle in ln z."""
        more, less = z * math.exp(_STEP), z * math.exp(-_STEP)
        return (one.bristle(more) - one.bristle(less)) / (2 * _STEP)

    def cost(self, z: float, delay: float) -> float:
        """Sum of the logarithms of both residuals, by their independent samples."""
        fits = (self.at_equal_load(z, delay), self.torque(z))
        return sum(
            weight * math.log(one.rms)
            for weight, one in zip(self.weights, fits, strict=True)
        )

    def over_torque(self, z: float, delay: float) -> ColouredFit:
        """Fit over the torque: 1/K, h, T_v, beta, gap, offset, error that repeats."""
        values = [one.deflection(delay) for one in self.motions]
        columns, precision = self._sprung(z)
        return fit_coloured(columns, values, precision)

    def spring(self, z: float, delay: float) -> ColouredFit:
        """The same over the part of the torque that motion and load explain.

        The noise of the torque would make the spring look stiffer: its column is
        replaced by its fit (least squares in two stages).
        """
        columns, precision = self._sprung(z)
        explained = [
            np.hstack([rest[:, 1:], one.load])
            for rest, one in zip(columns, self.motions, strict=True)
        ]
        scatter = np.std(np.concatenate([one.torque for one in self.motions]))
        # Prior errors that repeat stand for torques of up to the scatter.
        wide = np.where(precision[1:] > 0, scatter**-2.0, 0.0)
        load = np.full(self.motions[0].load.shape[1], (_PRIOR_SPREAD * scatter) ** -2)
        torques = [one.torque for one in self.motions]
        fit = fit_coloured(explained, torques, np.append(wide, load))
        for own, left in zip(columns, fit.residual, strict=True):
            own[:, 0] += left
        values = [one.deflection(delay) for one in self.motions]
        return fit_coloured(columns, values, precision)

    def _sprung(self, z: float) -> tuple[list[np.ndarray], np.ndarray]:
        """Columns of the deflection over the torque, and their precision."""
        columns = over_torque_columns(self.motions, z, self.gap)
        precision = np.zeros(columns[0].shape[1])
        if self.repeating is None:
            return columns, precision
        parts = [self.repeating.columns(one, z) for one in self.motions]
        own = self.repeating.precision(parts[0].shape[1])
        pairs = zip(columns, parts, strict=True)
        return [np.hstack(pair) for pair in pairs], np.append(precision, own)

    def solved(self, z: float, delay: float) -> JointReversal:
        """Drive at a travel and a delay."""
        deflected, torque = self.at_equal_load(z, delay), self.torque(z)
        over = self.over_torque(z, delay)
        spring = self.spring(z, delay)
        # Errors with that of z in them.
        r, F = -float(deflected.x[0]), float(torque.x[0])
        deflected = self.at_equal_load(z, delay, slope=-r or 1.0)
        torque = self.torque(z, slope=F or 1.0)
        estimate = lambda fit, i, sign=1.0: Estimate(
            sign * float(fit.x[i]), float(fit.errors[i])
        )
        late = estimate(deflected, 1)
        gap = UNKNOWN if self.gap is None else estimate(deflected, 4)
        return JointReversal(
            compliance=estimate(spring, 0),
            reversal=estimate(deflected, 0, -1.0),
            backlash=gap,
            presliding=z,
            presliding_interval=self._presliding_interval(z, delay),
            delay=Estimate(delay + late.value, late.error),
            coulomb=estimate(torque, 0),
            viscous=estimate(torque, 1),
            load_sides=self.load_sides,
            backlash_explained=self.explained,
            independent=spring.independent,
            fitted=over,
        )

    def travel_step(self, z: float, delay: float) -> Estimate:
        """Change of ln z that both fits at equal load ask for, by their errors."""
        F = float(self.torque(z).x[0]) or 1.0
        r = float(self.at_equal_load(z, delay).x[0]) or 1.0
        fits = (self.torque(z, slope=F), self.at_equal_load(z, delay, slope=r))
        steps = np.array([one.x[3] for one in fits])
        information = np.array([max(one.errors[3], 1e-12) ** -2.0 for one in fits])
        error = float(information.sum()) ** -0.5
        return Estimate(float(information @ steps) * error**2, error)

    def _presliding_interval(self, z: float, delay: float) -> tuple[float, float]:
        """Ends of the interval of 95 % of z [rad]; 0 or infinite if not tried."""
        factor = math.exp(_STUDENT * min(self.travel_step(z, delay).error, _SURELY))
        longest = self.motions[0].longest_presliding
        low, high = z / factor, z * factor
        is_low, is_high = low < _SHORTEST * longest, high > longest
        return 0.0 if is_low else low, math.inf if is_high else high

    def set_gap(self, z: float, delay: float) -> None:
        """Set the column of the gap if the load shows it.

        The torque of the spring is that which the motor's fits, less friction and
        inertia of the motor: the torque as measured would change its sign by noise.
        """
        torque = self.torque(z)
        # An error that repeats takes from the inertia of the motor what it can.
        over = JointEquations(self.motions, None, self.gap).spring(z, delay)
        if over.x[0] < _LEAST_RATIO * over.errors[0]:
            over = self.spring(z, delay)
        c, beta = float(over.x[0]), float(over.x[3])
        if not c > 0:
            return
        r = -float(self.at_equal_load(z, delay).x[0])
        held = [min(r / c, float(torque.x[0])), 0.0, float(torque.x[2]) - beta / c]
        records = len(self.motions)
        load, constants = torque.x[3:-records], torque.x[-records:]
        gap = []
        for one, constant in zip(self.motions, constants, strict=True):
            pull = one.torque_terms(z) @ np.array([*held, *load, constant])
            gap.append(one.low(-0.5 * np.sign(pull)))
        y = np.concatenate(gap)
        self.load_sides = float(0.5 - abs(np.mean(y)))
        self.gap = None
        if self.load_sides < _LEAST_SIDE:
            self.explained = 1.0
            return
        others = np.concatenate(
            [
                np.column_stack(
                    [one.bristle(z), one.velocity, one.acceleration, constant]
                )
                for one, constant in zip(
                    self.motions, offsets(self.motions), strict=True
                )
            ]
        )
        left = y - others @ np.linalg.lstsq(others, y, rcond=None)[0]
        self.explained = 1.0 - float(left @ left) / float(np.sum((y - y.mean()) ** 2))
        if self.explained < _MOST_EXPLAINED:
            self.gap = gap


def over_torque_columns(
    motions: Sequence[JointMotion], z: float, gap: list[np.ndarray] | None = None
) -> list[np.ndarray]:
    """Columns of 1/K, h, T_v, beta, the gap if any, and an offset per record."""
    columns = []
    for place, (one, constant) in enumerate(
        zip(motions, offsets(motions), strict=True)
    ):
        own = [-one.torque, one.bristle(z), -one.velocity, one.acceleration]
        if gap is not None:
            own.append(gap[place])
        columns.append(np.column_stack([*own, constant]))
    return columns
