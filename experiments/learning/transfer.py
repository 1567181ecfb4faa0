"""A part that was never cut: what parts of other programs have shown of the machine."""

import dataclasses

import numpy as np

import diffmill as dm
from diffmill import learning
from loop import HERE, TRACKER, drawn, tracked

# The block in its clamping, which is touched off once for all programs.
CORNERS = [
    [f"{x} mm", f"{y} mm", f"{z} mm"] for x in (0, 14) for y in (0, 10) for z in (0, -2)
]
# The moves in the air take 6.5 s, and are seen three times: 20 s.
TIMES = 3
CASES = {"one part": None, "one part and air": 24.0, "two parts": None}


def load(program):
    """Return the job of a program in the clamping of the boss."""
    changes = {"program.file": program, "registration.points": CORNERS}
    return dm.load_job(HERE / "boss.toml", changes=changes).with_precision()


def air_part(job, machine, stream):
    """Return what a tracker sees of moves in the air, their mean over some times."""
    command = np.asarray(job.path.positions)
    run = dm.simulate(machine, commanded=command)
    tips, noise = np.asarray(run.desired + run.surface_deviation), TRACKER / TIMES**0.5
    seen = tips + noise * stream.normal(size=tips.shape)
    return learning.Part(command, learning.TrackedTips(seen, noise))


def measure(report):
    """Print the table."""
    boss, other, air = (load(f"{n}.ngc") for n in ("boss", "chamfers", "air"))
    first, nominal = (np.asarray(dm.correct(job).commanded) for job in (boss, other))
    found = []
    machines = zip(*(drawn(job) for job in (boss, other, air)), strict=True)
    for number, (machine, unseen, in_air) in enumerate(machines):
        stream = np.random.default_rng(number)

        def error(command, machine=unseen):
            return dm.simulate(machine, commanded=command).contour.rms

        def of_another(posterior):
            settings = dataclasses.replace(other.correction, max_steps=8)
            job = dataclasses.replace(posterior.job_for(other), correction=settings)
            return error(dm.correct(job, start=nominal).commanded)

        part = lambda u, m=machine, s=stream: learning.Part(
            u, tracked(dm.simulate(m, commanded=u), s)
        )
        parts = [part(first)]
        one = dm.learn(boss, parts)
        seen = air_part(air, in_air, stream)
        known = dm.learn(air, [seen], prior=one.posterior, max_steps=0)
        two = dm.learn(boss, [*parts, part(one.commanded)], known=one, max_steps=0)
        errors = [error(nominal)]
        errors += [of_another(x.posterior) for x in (one, known, two)]
        report.say(
            f"  machine {number}: nominal correction {1e6 * errors[0]:.2f} um, after "
            + ", ".join(
                f"{n} {1e6 * e:.2f}" for n, e in zip(CASES, errors[1:], strict=True)
            )
        )
        found.append(errors)
    found = 1e6 * np.array(found)
    report.say(f"  nominal correction: median {np.median(found[:, 0]):.2f} um")
    share = np.max(found[:, 1] / found[:, 0])
    report.figure("after one part: largest share of the nominal error", share, 1.0, "-")
    for k, (case, limit) in enumerate(CASES.items(), 1):
        median, worst = np.median(found[:, k]), found[:, k].max()
        report.say(f"  after {case}: median {median:.2f} um, worst {worst:.2f}")
        if limit is not None:
            report.figure(f"after {case}: median", median, limit, "um")
            report.figure(f"after {case}: worst", worst, 27.0, "um")
