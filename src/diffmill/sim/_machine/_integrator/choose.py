"""The integrators by their names in a job."""

from typing import Literal, TypeAlias

from .base import AbstractIntegrator, Dynamics
from .midpoint import Midpoint
from .rk4 import RungeKutta4

IntegratorName: TypeAlias = Literal["midpoint", "rk4"]
_BY_NAME: dict[IntegratorName, type[Midpoint] | type[RungeKutta4]] = {
    "midpoint": Midpoint,
    "rk4": RungeKutta4,
}


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
    return _BY_NAME[name](dynamics)
