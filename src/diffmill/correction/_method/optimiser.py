"""The interface of methods that improve a command step by step."""

import abc

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..._types import FloatRows
from .._core.method import AbstractMethod, MethodResult, OnProgress
from .._core.problem import Motion, Problem
from .._spline.command_limits import LinearLimits
from .._spline.projection import project
from .._spline.spline_offsets import SplineOffsets
from .checkpoint import Arrays, OnCheckpoint


class AbstractOptimiser(AbstractMethod):
    """A method of many steps, whose state can be kept between two of them."""

    knot_spacing: eqx.AbstractVar[float]
    limits: eqx.AbstractVar[tuple[LinearLimits, ...]]

    @abc.abstractmethod
    def __call__(
        self,
        problem: Problem,
        *,
        start: FloatRows | None = None,
        on_progress: OnProgress | None = None,
        on_checkpoint: OnCheckpoint | None = None,
        resume: Arrays | None = None,
    ) -> MethodResult:
        """Outcome of the method.

        Args:
            problem: The problem.
            start: Command from which to start; the nominal one if None.
            on_progress: Called after every step with a message and the rms contour
                error so far [m]; True ends the method with the best so far.
            on_checkpoint: Called after every step with the state.
            resume: State from which to go on.
        """

    def towards_path(self) -> "AbstractOptimiser | None":
        """Method that first brings the rows near the surface onto the path, or None."""
        return None

    def excess(self, motion: Motion) -> float:
        """Distance of the surface to its bounds [m]; 0 within, or without any.

        Args:
            motion: Motion that leaves the surface.
        """
        del motion
        return 0.0

    def all_limits(
        self, spline: SplineOffsets, nominal: FloatRows
    ) -> tuple[LinearLimits, ...]:
        """Limits of the coefficients.

        Args:
            spline: Basis of the offset.
            nominal: The uncorrected command, shape (step, axis).
        """
        del spline, nominal
        return self.limits

    def begin(self, problem: Problem, start: FloatRows) -> FloatRows:
        """Command at which the iteration begins, within knots and limits.

        The closest to `start` that the method may return, shape (step, axis).

        Args:
            problem: The problem.
            start: Any command, shape (step, axis).

        **Differentiability**: none, a host function.
        """
        nominal = np.asarray(problem.nominal)
        spline = SplineOffsets(len(nominal), problem.time_step, self.knot_spacing)
        limits, bound = self.all_limits(spline, nominal), float(problem.max_offset)
        first = project(spline, np.asarray(start) - nominal, bound, limits=limits)
        return nominal + np.asarray(spline.offsets(jnp.asarray(first)))
