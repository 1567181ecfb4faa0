"""What the corrected command of the example `paper` leaves on other machines."""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import diffmill as dm
from shared import Report, example_job

# Parameters that are wrong by a factor: what is said, and how their names begin.
PARAMETERS = (("stiffness of all joints", "K "), ("K_tc", "K_tc"))
FACTORS = (0.9, 1.1)


def measure(report: Report) -> None:
    """Correct the example, and run its command where the model is not the machine.

    The cloud of points knows no bottom edges, so its command is one without them.
    """
    job = example_job("paper")
    command = dm.correct(job).commanded
    job = job.with_precision()
    settings = dataclasses.replace(job.simulation, has_bottom=False)
    plain = dataclasses.replace(job, simulation=settings)
    settings = dataclasses.replace(settings, chip="point_cloud", updates_per_period=1)
    cloud = dataclasses.replace(job, simulation=settings)
    report.say("What the corrected command leaves on another machine [um]")
    report.say(f"  {'machine':32}{'rms':>8}{'95 %':>8}{'max':>8}")
    _line(report, "as in the model", job, command)
    for name, start in PARAMETERS:
        for factor in FACTORS:
            other = _scaled(job, start, factor)
            _line(report, f"{name} {factor - 1:+.0%}", other, command)
    without = dm.correct(plain).commanded
    _line(report, "as in the model, no bottom edges", plain, without)
    _line(report, "chip of the paper, no bottom edges", cloud, without)


def _line(
    report: Report, name: str, job: dm.Job, command: Float[Array, "step 3"]
) -> None:
    """Say the errors of a command on the machine of a job."""
    contour = dm.simulate(job, commanded=command).contour
    rms, p95, largest = (1e6 * x for x in (contour.rms, contour.p95, contour.max))
    report.say(f"  {name:32}{rms:8.2f}{p95:8.2f}{largest:8.1f}")


def _scaled(job: dm.Job, start: str, factor: float) -> dm.Job:
    """Return the job with another size of the parameters whose names begin so."""
    is_changed = [name.startswith(start) for name in job.parameter_names]
    return job.with_scaled(jnp.where(np.array(is_changed), np.log(factor), 0.0))
