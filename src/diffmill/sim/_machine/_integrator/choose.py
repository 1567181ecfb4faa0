"""The integrators by their settings."""

from ....settings.base import builds
from ....settings.simulation import (
    IntegratorSettings,
    MidpointSettings,
    RungeKutta4Settings,
)
from .base import AbstractIntegrator, Dynamics
from .midpoint import Midpoint
from .rk4 import RungeKutta4


@builds(MidpointSettings)
def _midpoint(settings: MidpointSettings, dynamics: Dynamics) -> Midpoint:
    return Midpoint(dynamics)


@builds(RungeKutta4Settings)
def _runge_kutta_4(settings: RungeKutta4Settings, dynamics: Dynamics) -> RungeKutta4:
    return RungeKutta4(dynamics)


def make_integrator(
    settings: IntegratorSettings, dynamics: Dynamics = "crba"
) -> AbstractIntegrator:
    """Integrator of some settings.

    Args:
        settings: The settings, whose class chooses it.
        dynamics: Algorithm of the robot's dynamics, "crba" or "aba".
    """
    integrator = settings.build(dynamics)
    assert isinstance(integrator, AbstractIntegrator)
    return integrator
