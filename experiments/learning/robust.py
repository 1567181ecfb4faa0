"""What robust commands leave on machines that were drawn, beside the nominal one."""

import dataclasses

import numpy as np

import diffmill as dm
from loop import drawn, load

MACHINES, MEMBERS = 4, 4
# What may be off, as a user may state it of the machines of `[truth]`.
MODEL = {"stiffness": 0.1, "damping": 0.2, "force": 0.3}
ARM = {"links": 0.5e-3, "link_angles": 0.5e-3, "backlash": 60e-6, "friction": 40e-6}


def measure(report):
    """Print the errors of the commands on the same machines."""
    job = load()
    truth = dataclasses.replace(job.truth, draws=MACHINES)
    # Machines of the distribution of those below: no uncertainty is stated better.
    members = drawn(job, MEMBERS, seed=truth.seed + 1)
    exact = dict.fromkeys((*MODEL, "force_bias", "links", "link_angles"), 0.0)
    reversing = drawn(job, 1, **exact)
    nominal = dm.correct(job)
    found = {
        "nominal": nominal,
        "nominal, with the reversal": dm.correct(job, machines=reversing),
        "robust: stiffness, damping, forces": dm.correct(_uncertain(job, MODEL)),
        "robust: and reversal, links": dm.correct(_uncertain(job, MODEL | ARM)),
        "robust: members as the machines": dm.correct(job, machines=members),
    }
    cases = {"uncorrected": nominal.before} | {k: x.after for k, x in found.items()}
    commands = {name: np.asarray(case.commanded) for name, case in cases.items()}
    errors = dm.sim.TrueErrors.of_commands(job, truth, commands)
    report.say(f"contour error [um rms] on {MACHINES} machines drawn by [truth]")
    report.say(f"  {'command':36}{'model':>8}{'median':>8}{'worst':>8}   time [s]")
    for name, case in cases.items():
        seconds = found[name].wall_time["corrected"] if name in found else 0.0
        of_machines = errors.median(name), errors.worst(name)
        each = "".join(f"{1e6 * e:8.2f}" for e in (case.contour.rms, *of_machines))
        report.say(f"  {name:36}{each}{seconds:9.0f}")
    best = errors.median("robust: and reversal, links")
    report.at_least("nominal over robust, median", errors.median("nominal") / best, 1.2)


def _uncertain(job, sizes):
    """Return the job with an uncertainty."""
    known = dm.UncertaintySettings(**sizes, draws=MEMBERS, seed=1)
    settings = dataclasses.replace(job.correction, uncertainty=known)
    return dataclasses.replace(job, correction=settings)
