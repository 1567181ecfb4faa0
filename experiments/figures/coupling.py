"""The process alone on the coupled run's actual path gives the coupled forces."""

import jax
import numpy as np

import diffmill as dm
from shared import Report, example_job, relative


def measure(report: Report) -> None:
    """Compare the forces of both runs of the small example."""
    job = example_job("paper_small").with_precision()
    coupled = dm.simulate(job, adjoint=dm.process.ThroughPoses())
    alone = jax.jit(
        lambda tips: (
            dm.sim.simulate_process(
                tips,
                job.stock,
                job.cutter,
                job.law,
                job.spindle_speed,
                engagement=dm.sim.MachiningProblem.of(
                    job, dm.process.ThroughRays()
                ).process.engagement,
                adjoint=dm.process.ThroughPoses(),
            ).force
        )
    )(coupled.actual)
    wanted = np.asarray(coupled.force)
    difference = np.linalg.norm(np.asarray(alone) - wanted, axis=1)
    largest = np.linalg.norm(wanted, axis=1).max()
    report.say()
    report.say(f"paper_small, {wanted.shape[0]} tooth periods")
    report.say(f"  largest force {largest:.1f} N")
    report.figure(
        "rms difference over the rms force", 100 * relative(alone, wanted), 1.0
    )
    report.figure(
        "largest difference over the largest force",
        100 * difference.max() / largest,
        1.0,
    )
    share = np.mean(difference > 0.01 * largest)
    report.say(f"  rows off by more than 1 % of the largest force: {100 * share:.2f} %")
