"""Robust fit of link errors to measured poses, with priors in units.

Each unknown x_i has a normal prior of standard deviation s_i, so that parameters that
do the same need not be taken out: what the poses leave open stays where the prior has
it. With u = x / s the cost is

    1/2 [ sum rho(r / sigma) + |u|^2 ],

rho Huber's loss and sigma the scatter of a coordinate: that of the residual by its
median, not below the noise that the user states.
"""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ...optimise import (
    AbstractProblem,
    LevenbergMarquardt,
    QuadraticModel,
    least_squares,
)
from ...robot import LinkErrors
from .._statistics.robust_regression import Loss, robust_cost, robust_weight
from .model import KinematicModel, MeasuredPoses, residual, residual_slopes
from .parameters import link_errors

# Median absolute deviation over the standard deviation of a normal distribution.
_MAD = 0.6744897501960817
_STEPS = 40
# Squared length of a step in standard errors at which the iteration ends.
_STILL = 1e-6
# A residual of so many standard deviations contradicts the other poses.
_GROSS = 8.0
# Of a normal distribution, for intervals of 95 %.
_NORMAL_95 = 1.959963984540054


@dataclasses.dataclass(frozen=True)
class InstrumentNoise:
    """Standard deviations of one measured coordinate, the robot's repeatability in it.

    Attributes:
        length: [m].
        angle: [rad].
    """

    length: float
    angle: float = 0.0


class KinematicFit(eqx.Module):
    """Link errors, and how sure they are.

    Attributes:
        model: The robot as stated, with the unknowns.
        x: Their values [m or rad], shape (unknown,).
        covariance: Of these, with the prior [m^2 ...], shape (unknown, unknown).
        residual: Measured less predicted [m, rad], shape (pose, component).
        spread: Scatter of a coordinate by group, lengths and then angles [m, rad].
        outliers: Places of poses that contradict the others, ascending.
        has_converged: Whether the last step was small.
    """

    model: KinematicModel
    x: Float[np.ndarray, " unknown"]
    covariance: Float[np.ndarray, "unknown unknown"]
    residual: Float[np.ndarray, "pose component"]
    spread: Float[np.ndarray, " group"]
    outliers: tuple[int, ...]
    has_converged: bool

    @property
    def standard_errors(self) -> Float[np.ndarray, " unknown"]:
        """Standard errors of the unknowns [m or rad]."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def interval(self) -> Float[np.ndarray, "unknown 2"]:
        """Least and largest value with 95 % confidence [m or rad]."""
        half = _NORMAL_95 * self.standard_errors
        return np.stack([self.x - half, self.x + half], axis=1)

    @property
    def known_share(self) -> Float[np.ndarray, " unknown"]:
        """Share of each unknown's prior variance that the poses have taken away."""
        return 1.0 - np.diagonal(self.covariance) / self.model.sizes**2

    @property
    def errors(self) -> LinkErrors:
        """The errors by joint."""
        return self._by_joint(self.x)

    @property
    def standard_link_errors(self) -> LinkErrors:
        """Their standard errors, each in its place; 0 for what was not fitted."""
        return self._by_joint(self.standard_errors)

    def _by_joint(self, x: Float[np.ndarray, " unknown"]) -> LinkErrors:
        """Values of the unknowns in their places."""
        model = self.model
        return link_errors(
            model.parameters, jnp.asarray(x), model.robot, model.waves_per_turn
        )

    @property
    def named(self) -> dict[str, float]:
        """Values of the unknowns by name [m or rad]."""
        names = [one.name for one in self.model.parameters]
        return dict(zip(names, self.x.tolist(), strict=True))


class _CalibrationProblem(AbstractProblem):
    """Measured poses at scaled unknowns."""

    kinematics: KinematicModel
    poses: MeasuredPoses
    is_used: Bool[np.ndarray, " pose"]
    floor: Float[np.ndarray, " group"]
    loss: Loss = eqx.field(static=True)

    def evaluate(
        self, x: Float[np.ndarray, " unknown"]
    ) -> Float[np.ndarray, "pose component"]:
        """Residual [m, rad]."""
        at = jnp.asarray(x * self.kinematics.sizes)
        return np.asarray(residual(self.kinematics, at, self.poses))

    def columns(
        self, x: Float[np.ndarray, " unknown"], spread: Float[np.ndarray, " component"]
    ) -> Float[np.ndarray, "number unknown"]:
        """Slopes of the scaled residual of the used poses, one row per number."""
        sizes = self.kinematics.sizes
        J = np.asarray(
            residual_slopes(self.kinematics, jnp.asarray(x * sizes), self.poses)
        )
        J = J[self.is_used] / spread[None, :, None] * sizes[None, None]
        return J.reshape(-1, len(sizes))

    def spread(
        self, value: Float[np.ndarray, "pose component"]
    ) -> Float[np.ndarray, " group"]:
        """Scatter of a coordinate in each group [m, rad]."""
        used = value[self.is_used]
        middle = [np.median(np.abs(used[:, part])) for part in self.poses.groups]
        return np.maximum(np.array(middle) / _MAD, self.floor)

    def by_component(
        self, spread: Float[np.ndarray, " group"]
    ) -> Float[np.ndarray, " component"]:
        """Scatter of each component [m, rad]."""
        widths = [part.stop - part.start for part in self.poses.groups]
        return np.repeat(spread, widths)

    def model(
        self,
        x: Float[np.ndarray, " unknown"],
        value: Float[np.ndarray, "pose component"],
    ) -> QuadraticModel:
        """Quadratic model of the robust cost, weighed by the scatter there."""
        spread = self.by_component(self.spread(value))
        J = self.columns(x, spread)
        r = (value[self.is_used] / spread[None]).reshape(-1)
        w = robust_weight(r, self.loss)

        def cost(
            there: Float[np.ndarray, " unknown"],
            at: Float[np.ndarray, "pose component"],
        ) -> float:
            scaled = at[self.is_used] / spread[None]
            return 0.5 * (robust_cost(scaled, self.loss) + float(there @ there))

        curvature = (J * w[:, None]).T @ J + np.eye(len(x))
        return QuadraticModel(cost, J.T @ (w * r) + x, curvature)


def fit_kinematics(
    model: KinematicModel,
    poses: MeasuredPoses,
    noise: InstrumentNoise,
    *,
    is_used: Bool[np.ndarray, " pose"] | None = None,
    start: Float[np.ndarray, " unknown"] | None = None,
    loss: Loss = "huber",
) -> KinematicFit:
    """Fit link errors, tool and base to measured poses.

    Args:
        model: The robot and the unknowns.
        poses: What was measured.
        noise: Of the instrument.
        is_used: Poses that count, shape (pose,); all if not given.
        start: Values from which the iteration begins [m or rad], shape (unknown,).
        loss: "huber" or "squares".

    Returns:
        The fit; its residual is that of all poses.
    """
    used = np.ones(len(poses.q), bool) if is_used is None else is_used
    floor = np.array([noise.length, noise.angle])[: len(poses.groups)]
    problem = _CalibrationProblem(model, poses, used, floor, loss)
    x0 = np.zeros(len(model.parameters)) if start is None else start / model.sizes
    solver = LevenbergMarquardt(
        max_steps=_STEPS, step_rtol=_STILL, rejected_step_rtol=_STILL
    )
    solution = least_squares(problem, x0, solver)
    value, u = solution.value, solution.x
    spread = problem.spread(value)
    by_component = problem.by_component(spread)
    J = problem.columns(u, by_component)
    scaled = value / by_component[None]
    r = scaled[used].reshape(-1)
    # Variance of the estimate over that of least squares (Huber 1981), at the scatter
    # that the residual would have without the freedom that the fit has taken.
    psi, is_within = robust_weight(r, loss) * r, robust_weight(r, loss) == 1.0
    inflation = float(np.mean(psi**2) / np.mean(is_within) ** 2)
    prior = np.eye(len(u))
    # At the stated noise alone all is known that can be.
    taken = len(u) - np.trace(np.linalg.inv(J.T @ J + prior))
    freedom = max(r.size - taken, 1.0)
    inflation = max(inflation, 0.0) * r.size / freedom
    # The scatter is no less than the noise that is stated.
    inflation = max(inflation, float(np.min((floor / spread) ** 2)))
    P = np.linalg.inv(J.T @ J / inflation + prior)
    is_gross = used & (np.abs(scaled).max(axis=1) > _GROSS)
    return KinematicFit(
        model=model,
        x=u * model.sizes,
        covariance=P * model.sizes[:, None] * model.sizes[None],
        residual=value,
        spread=spread * np.sqrt(inflation),
        outliers=tuple(np.flatnonzero(is_gross).tolist()),
        has_converged=solution.has_converged,
    )
