"""A part that was never cut, right the first time: parameters learnt from another."""

import dataclasses

import numpy as np

import diffmill as dm
from diffmill import learning
from loop import HERE, drawn, tracked

# The block in its clamping, which is touched off once for all programs.
CORNERS = [
    [f"{x} mm", f"{y} mm", f"{z} mm"] for x in (0, 14) for y in (0, 10) for z in (0, -2)
]
PARTS = 2
MACHINES = 4


def load(program):
    """Return the job of a program in the clamping of the boss."""
    changes = {"program.file": program, "registration.points": CORNERS}
    return dm.load_job(HERE / "boss.toml", changes=changes).with_precision()


def carried_over(learnt, job):
    """Return another job with a machine that was learnt: parameters, no process."""
    machine = learning.AdaptableMachine.of_job(job, learning.MachinePrior())
    field = learnt.machine.field(learnt.parameters, np.asarray(job.path.positions))
    path = dataclasses.replace(job.path, disturbance=field)
    return dataclasses.replace(machine.job_at(learnt.parameters), path=path)


def measure(report):
    """Print the table."""
    boss, other = load("boss.ngc"), load("chamfers.ngc")
    first, nominal = (np.asarray(dm.correct(job).commanded) for job in (boss, other))
    found = []
    machines = zip(drawn(boss, MACHINES), drawn(other, MACHINES), strict=True)
    for number, (machine, unseen) in enumerate(machines):
        stream = np.random.default_rng(number)
        error = lambda u, job=unseen: dm.simulate(job, commanded=u).contour.rms
        errors, parts, known = [error(nominal)], [], None
        command = first
        for _ in range(PARTS):
            run = dm.simulate(machine, commanded=command)
            parts.append(learning.Part(command, tracked(run, stream)))
            known = dm.learn(boss, parts, known=known)
            command = known.commanded
            corrected = dm.correct(carried_over(known, other), start=nominal)
            errors.append(error(corrected.commanded))
        report.say(
            f"  machine {number}: nominal correction {1e6 * errors[0]:.2f} um, after "
            "parts of another program "
            + ", ".join(f"{1e6 * e:.2f}" for e in errors[1:])
        )
        found.append(errors)
    found = 1e6 * np.array(found)
    report.say(f"  nominal correction: median {np.median(found[:, 0]):.2f} um")
    share = np.max(found[:, 1:] / found[:, :1])
    report.figure("largest share of the nominal error", share, 1.0, "-")
    for parts in range(1, PARTS + 1):
        median, worst = np.median(found[:, parts]), found[:, parts].max()
        report.say(f"  after {parts}: median {median:.2f} um, worst {worst:.2f}")
