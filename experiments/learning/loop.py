"""The closed loop: cut, measure, learn, cut again, on machines that are drawn."""

import dataclasses
import pathlib

import numpy as np

import diffmill as dm
from diffmill import learning

HERE = pathlib.Path(__file__).parent
TRACKER, PROBE = 15e-6, 3e-6
ROUNDS, SPACING = 3, 2e-3
# How many are drawn: each takes some minutes.
MACHINES = 4


def load():
    """Return the job of the boss, in its precision."""
    return dm.load_job(HERE / "boss.toml").with_precision()


def tracked(run, stream):
    """Return what a tracker sees of a run."""
    tips = np.asarray(run.desired) + np.asarray(run.surface_deviation)
    noise = TRACKER * stream.normal(size=tips.shape)
    return learning.TrackedTips(tips + noise, TRACKER)


def probed(run, stream, radius):
    """Return points of the walls, one each 2 mm, with their normals."""
    desired, cuts = np.asarray(run.desired), np.asarray(run.is_cutting)
    way = np.gradient(desired[:, :2], axis=0)
    size = np.linalg.norm(way, axis=1)
    length = np.concatenate(
        [[0], np.cumsum(np.hypot(*np.diff(desired[:, :2], axis=0).T))]
    )
    rows, last = [], -np.inf
    for k in np.flatnonzero(cuts & (size > 1e-9)):
        if length[k] - last >= SPACING:
            rows.append(k)
            last = length[k]
    rows = np.array(rows)
    # The part is to the right of the feed, and its walls look to the tool.
    left = np.stack([-way[rows, 1], way[rows, 0]], axis=1) / size[rows, None]
    normals = np.concatenate([left, np.zeros((len(rows), 1))], axis=1)
    error = np.sum(np.asarray(run.surface_deviation)[rows] * normals, axis=1)
    error = error + PROBE * stream.normal(size=len(rows))
    points = desired[rows] + (error - radius)[:, None] * normals
    points[:, 2] += 0.5e-3
    return learning.WallPoints(points, normals, PROBE)


def closed_loop(job, machine, first, see, rounds=ROUNDS):
    """Return the contour errors of the parts that are cut one after the other [m]."""
    commands, parts, errors, known = [first], [], [], None
    for _ in range(rounds):
        run = dm.simulate(machine, commanded=commands[-1])
        errors.append(run.contour.rms)
        parts.append(learning.Part(commands[-1], see(run)))
        known = dm.learn(job, parts, known=known)
        commands.append(known.commanded)
    errors.append(dm.simulate(machine, commanded=commands[-1]).contour.rms)
    return np.array(errors)


def table(report, job, machines, see, rounds=ROUNDS):
    """Print the errors of the parts on some machines, and return them [m]."""
    first = np.asarray(dm.correct(job).commanded)
    found = []
    for number, machine in enumerate(machines):
        stream = np.random.default_rng(number)
        errors = closed_loop(
            job, machine, first, lambda run, s=stream: see(run, s), rounds
        )
        report.say(
            f"  machine {number}: nominal correction {1e6 * errors[0]:.2f} um, then "
            + ", ".join(f"{1e6 * e:.2f}" for e in errors[1:])
        )
        found.append(errors)
    return np.array(found)


def judge(report, found, limits):
    """Compare medians and worst of the rounds with their limits [um]."""
    for number, (median, worst) in enumerate(limits, 1):
        errors = 1e6 * found[:, number]
        report.figure(f"after part {number}: median", np.median(errors), median, "um")
        report.figure(f"after part {number}: worst", errors.max(), worst, "um")
    rises = 1e6 * np.diff(found[:, 1:], axis=1)
    if rises.size:
        report.figure("largest rise from a part to the next", rises.max(), 1.0, "um")


def drawn(job, count=MACHINES, **sizes):
    """Return machines as `[truth]` draws them, with other sizes."""
    truth = dataclasses.replace(job.truth, **sizes)
    return [dm.sim.drawn_machine(job, truth, k) for k in range(count)]
