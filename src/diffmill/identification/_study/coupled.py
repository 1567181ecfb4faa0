"""Stiffness, damping and force coefficients from one record of a robot's cut."""

import dataclasses

import numpy as np
from jaxtyping import Float

from ..._job import Job
from .._coupled.fit_coupled import CoupledFit, fit_coupled
from .._coupled.model import mean_over_period
from .._record.record import MeasuredChannel
from .study import OnProgress, StudyError, silent


@dataclasses.dataclass(frozen=True)
class CoupledStudy:
    """A record of a robot's cut; see `identification.fit_coupled`.

    Attributes:
        name: The file.
        job: The job that was run.
        time: On the clock of the job's path [s], shape (row,).
        force: On the tool in `work`, as sampled [N], shape (row, 3), or None.
        deviation: Tip minus desired tip in `work` [m], shape (row, 3), or None.
        fit: Names of the parameters to fit, or None.
        has_offset: Whether a constant deviation is fitted too.
        has_time_shift: Whether a shift of the clock is fitted too.
        loss: "squares" or "huber".
        notes: What was assumed.
        channels: The columns that were read; none where a script gives the numbers.
        kind: Kind of the measurements.
        Fit: Result of `run`.
    """

    name: str
    job: Job
    time: Float[np.ndarray, " row"]
    force: Float[np.ndarray, "row 3"] | None
    deviation: Float[np.ndarray, "row 3"] | None
    fit: tuple[str, ...] | None
    has_offset: bool
    has_time_shift: bool
    loss: str
    notes: tuple[str, ...]
    channels: tuple[MeasuredChannel, ...] = ()
    kind = "coupled"
    Fit = CoupledFit

    @property
    def compared(self) -> dict[str, Float[np.ndarray, "row 3"]]:
        """Measurements that are compared with the simulation, "force" and "deviation".

        The simulated force is a mean over the tooth period; a record that is sampled
        faster is averaged too.
        """
        force, period = self.force, float(self.job.tooth_period)
        if force is not None and float(np.median(np.diff(self.time))) < 0.9 * period:
            force = mean_over_period(self.time, force, period)
        both = {"force": force, "deviation": self.deviation}
        return {name: rows for name, rows in both.items() if rows is not None}

    def run(self, on_progress: OnProgress = silent) -> CoupledFit:
        """Fit the parameters of arm and cut.

        Args:
            on_progress: Receives a line about each step.

        Raises:
            StudyError: The record cannot be fitted.
            SimulationFailed: The job could not be simulated.
        """
        on_progress("arm and cut")
        try:
            return fit_coupled(
                self.job,
                force=self.compared.get("force"),
                deviation=self.compared.get("deviation"),
                time=self.time,
                fit=self.fit,
                has_offset=self.has_offset,
                has_time_shift=self.has_time_shift,
                loss=self.loss,  # pyright: ignore[reportArgumentType]
                on_progress=on_progress,
            )
        except ValueError as error:
            raise StudyError(f"{self.name}: {error}") from error
