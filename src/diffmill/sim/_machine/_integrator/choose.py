"""The integrators by their names in a job."""

from typing import Literal, TypeAlias

from .base import AbstractIntegrator, Dynamics
from .midpoint import Midpoint
from .rk4 import RungeKutta4

IntegratorName: TypeAlias = Literal["midpoint", "rk4"]


def make_integrator(
    name: IntegratorName, dynamics: Dynamics = "crba"
) -> AbstractIntegrator:
    """Return the integrator of a name.

    Args:
        name: "midpoint" or "rk4".
        dynamics: Algorithm of the robot's dynamics, "crba" or "aba".

    Returns:
        The integrator.
    """
    return Midpoint(dynamics) if name == "midpoint" else RungeKutta4(dynamics)
