"""Measurements of one kind, and the fit of all of them with its checks."""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

# Receives a line about each step of a fit.
OnProgress = Callable[[str], None]


class StudyError(ValueError):
    """Measurements that a study cannot fit; the message names them."""


def silent(message: str) -> None:
    """Take a message and do nothing."""
    del message


@runtime_checkable
class Study(Protocol):
    """Measurements of one kind, ready to be fitted."""

    @property
    def name(self) -> str:
        """Name of the file that describes them."""
        ...

    @property
    def kind(self) -> str:
        """Kind of the measurements, as in the file."""
        ...

    def run(self, on_progress: OnProgress = silent) -> object:
        """Fit of the measurements, of the type that the study calls `Fit`.

        Args:
            on_progress: Receives a line about each step.

        Raises:
            StudyError: The measurements cannot be fitted.
            SimulationFailed: A cut could not be simulated.
        """
        ...
