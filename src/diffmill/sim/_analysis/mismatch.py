"""Error that a command leaves on machines and materials beside the model."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ..._job import Job, parameter_uncertainty
from ..._result import RESULTS
from ...process import FrozenStock
from ...toolpath import ContourStatistics
from .._job.simulate import Solution


class Mismatch(NamedTuple):
    """Error of a command where one kind of parameter is off by a share.

    Attributes:
        kind: "stiffness" of all joints or modes, or "force" for the coefficients of
            the law.
        share: How far they are off.
        less: Root mean square contour error where the tool cuts, with all of them less
            by the share [m]; NaN if that run fails.
        more: With all of them more by the share.
    """

    kind: str
    share: float
    less: float
    more: float

    @property
    def worse(self) -> float:
        """The larger error [m]; NaN if one of the runs fails."""
        return float(np.maximum(self.less, self.more))


def mismatch(job: Job, solution: Solution, share: float = 0.1) -> tuple[Mismatch, ...]:
    """Run the command of a solution where stiffness or forces are not as modelled.

    Each stiffness has its own sag lifted, as touching off does.

    Args:
        job: The job; its machine must not be rigid.
        solution: Its solution, whose command is run.
        share: How far the parameters are off, above 0 and below 1.

    Returns:
        The errors with another stiffness, and with other forces.

    Raises:
        ValueError: The machine is rigid, the share is out of bounds, or JAX is not set
            up for the job's precision.

    Differentiability: runs on the host, not traceable; `sensitivity` has slopes.
    """
    job = job.with_precision()
    if job.is_rigid:
        raise ValueError("Argument `job` must not have a rigid machine, but has.")
    if not 0 < share < 1:
        raise ValueError(
            f"Argument `share` must be above 0 and below 1, but is {share}."
        )
    names, cuts = job.parameter_names, np.asarray(solution.is_cutting)
    off = {"stiffness": 0.0, "damping": 0.0, "force": 0.0}

    def rms_error(kind: str, factor: float) -> float:
        is_off = parameter_uncertainty(names, **{**off, kind: 1.0})
        other = job.with_scaled(jnp.asarray(is_off * np.log(factor)))
        run = Solution.of_command(
            other, solution.rigid, solution.commanded, FrozenStock()
        )
        if bool(run.result != RESULTS.successful):
            return np.nan
        return ContourStatistics.of(run.contour_error, cuts).rms if cuts.any() else 0.0

    return tuple(
        Mismatch(kind, share, rms_error(kind, 1 - share), rms_error(kind, 1 + share))
        for kind in ("stiffness", "force")
    )
