"""What parts have shown of a machine, for other programs and other processes."""

import dataclasses
import os
from typing import TYPE_CHECKING

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .._job import Job
from .._types import FloatRows3
from ._parameters import AdaptableMachine, MachinePrior, Rows3

if TYPE_CHECKING:
    import xarray

# Paths are the same within this [m].
_SAME_PLACE = 1e-9


class MachinePosterior(eqx.Module):
    """Parameters of a machine as parts have shown them, and what none of them explains.

    Attributes:
        mean: Parameters in units of their priors, shape (parameter,).
        covariance: Of these, shape (parameter, parameter).
        sizes: Standard deviations of the priors, shape (parameter,).
        names: Of the parameters.
        center: Point of the work about which the field turns [m], shape (3,).
        desired: Path along which the process holds [m], shape (step, 3).
        disturbance: Mean of what no parameter explains [m], shape (step, 3).
        uncertainty: Its standard deviation [m], shape (step, 3).
        normals: Normals out of the walls that were measured, shape (step, 3); zero
            where none was.
    """

    mean: Float[np.ndarray, " parameter"]
    covariance: Float[np.ndarray, "parameter parameter"]
    sizes: Float[np.ndarray, " parameter"]
    names: tuple[str, ...] = eqx.field(static=True)
    center: Float[np.ndarray, " 3"]
    desired: Rows3
    disturbance: Rows3
    uncertainty: Rows3
    normals: Rows3

    @classmethod
    def of_prior(cls, job: Job, prior: MachinePrior) -> "MachinePosterior":
        """Posterior of no part: the model, and how far it may be off.

        Args:
            job: The job, in its precision.
            prior: Sizes of what may be wrong.
        """
        machine = AdaptableMachine.of_job(job, prior)
        desired = np.asarray(job.path.positions, np.float64)
        return cls(
            mean=np.zeros(machine.count),
            covariance=np.diag(machine.is_free.astype(float)),
            sizes=machine.sizes,
            names=machine.names,
            center=machine.center,
            desired=desired,
            disturbance=np.zeros_like(desired),
            uncertainty=np.zeros_like(desired),
            normals=np.zeros_like(desired),
        )

    def machine_for(self, job: Job) -> AdaptableMachine:
        """Machine of a job, as a function of these parameters.

        Args:
            job: The job, in its precision; of any program.

        Raises:
            ValueError: The job's machine has other parameters.
        """
        machine = AdaptableMachine.of_job(job, MachinePrior())
        if machine.names != self.names:
            other = [n for n in machine.names if n not in self.names] or ["less"]
            lost = [n for n in self.names if n not in machine.names] or ["no less"]
            raise ValueError(
                "Argument `job` must have the joints and force coefficients of the "
                f"machine that was learnt, but has {', '.join(other)} and lacks "
                f"{', '.join(lost)}."
            )
        machine = dataclasses.replace(machine, sizes=self.sizes, center=self.center)
        if self.is_of(job):
            machine = dataclasses.replace(machine, normals=self.normals)
        return machine

    def is_of(self, job: Job) -> bool:
        """True for a job with the program along which the process holds."""
        own = np.asarray(job.path.positions)
        return own.shape == self.desired.shape and bool(
            np.abs(own - self.desired).max() < _SAME_PLACE
        )

    def job_for(
        self, job: Job, parameters: Float[np.ndarray, " parameter"] | None = None
    ) -> Job:
        """Job of a program on the machine that was learnt, touched off.

        What no parameter explains goes with the program along which it was seen, and
        not to another one; nor does a radius that is off, for which the walls must be
        known.

        Args:
            job: The job, in its precision; of any program.
            parameters: Others than the mean, such as those of a draw.

        Raises:
            ValueError: The job's machine has other parameters.
        """
        machine = self.machine_for(job)
        x = self.mean if parameters is None else parameters
        adapted = machine.job_at(x)
        more = machine.field(x, np.asarray(job.path.positions))
        if self.is_of(job):
            more = more + self.disturbance + machine.wall_columns() @ x
        own = job.path.disturbance
        path = dataclasses.replace(
            adapted.path, disturbance=more if own is None else own + more
        )
        return dataclasses.replace(adapted, path=path)

    def drawn_jobs(self, job: Job, count: int, *, seed: int = 0) -> tuple[Job, ...]:
        """Jobs on machines as they may be, after what parts have shown.

        Friction and gaps are not drawn below zero; what no parameter explains has its
        mean. `correct(job, machines=...)` is robust against them.

        Args:
            job: The job, in its precision; of any program.
            count: How many are drawn.
            seed: Seed of the draws.

        Raises:
            ValueError: The job's machine has other parameters.
        """
        stream, lower = np.random.default_rng(seed), self.machine_for(job).lower
        draw = lambda: stream.multivariate_normal(
            self.mean, self.covariance, method="eigh"
        )
        return tuple(self.job_for(job, np.maximum(draw(), lower)) for _ in range(count))

    def to_dataset(self) -> "xarray.Dataset":
        """All of it as an `xarray.Dataset`."""
        import xarray

        return xarray.Dataset(
            {
                "mean": ("parameter", self.mean),
                "covariance": (("parameter", "other_parameter"), self.covariance),
                "size": ("parameter", self.sizes),
                "center": ("axis", self.center),
                "desired": (("step", "axis"), self.desired),
                "disturbance": (("step", "axis"), self.disturbance),
                "uncertainty": (("step", "axis"), self.uncertainty),
                "normal": (("step", "axis"), self.normals),
            },
            coords={"parameter": list(self.names), "axis": list("xyz")},
            attrs={"title": _TITLE},
        )

    @classmethod
    def read(cls, file: str | os.PathLike[str]) -> "MachinePosterior":
        """Posterior of a file that `to_dataset` filled.

        Args:
            file: The netCDF file.

        Raises:
            ValueError: It holds something else.
            OSError: It cannot be read.
        """
        import xarray

        with xarray.open_dataset(file, engine="h5netcdf") as dataset:
            if dataset.attrs.get("title") != _TITLE:
                raise ValueError("holds no machine that `learn` has written")
            of = lambda name: np.asarray(dataset[name].values, np.float64)
            names = tuple(str(name) for name in dataset["parameter"].values)
            rows = map(of, ("desired", "disturbance", "uncertainty", "normal"))
            return cls(
                of("mean"), of("covariance"), of("size"), names, of("center"), *rows
            )


_TITLE = "machine as measured parts show it"


def normal_variance(
    covariance: Float[np.ndarray, "step 3 3"], desired: FloatRows3
) -> Float[np.ndarray, " step"]:
    """Variance of a tip across its path [m^2].

    Args:
        covariance: Of the tip [m^2], shape (step, 3, 3).
        desired: The path [m], shape (step, 3).
    """
    way = np.gradient(np.asarray(desired, np.float64), axis=0)
    size = np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-15)
    along = np.einsum("ka,kab,kb->k", way / size, covariance, way / size)
    return np.maximum(np.trace(covariance, axis1=1, axis2=2) - along, 0.0)
