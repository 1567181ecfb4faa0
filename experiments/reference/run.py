"""Numbers of six jobs, stored, and compared after a change that should change none.

python experiments/reference/run.py store FILE.npz [--jobs tiny ...]
python experiments/reference/run.py compare FILE.npz [--jobs tiny ...]

Of each job tips, forces and the final rays of its simulation, the gradient of the mean
squared deviation by the command, and what each step of the correction left. Both
commands must run on one machine: rounding differs between processors.
"""

import argparse
import pathlib
import sys
import tempfile

import jax
import jax.numpy as jnp
import numpy as np

jax.config.update("jax_enable_x64", True)
HERE = pathlib.Path(__file__).parent
sys.path += [str(HERE.parent / "common"), str(HERE.parents[1] / "tests")]

import diffmill as dm  # noqa: E402
from jobs import NAMES, reference_job  # noqa: E402
from reporting import Report  # noqa: E402

# Relative to the largest number of a kind.
SAME = 1e-12


def numbers(name: str) -> dict[str, np.ndarray]:
    """Return the numbers of a job, by kind."""
    with tempfile.TemporaryDirectory() as folder:
        job = reference_job(name, pathlib.Path(folder))
    solution = dm.simulate(job)
    job = job.with_precision()

    def cost(commanded):
        ran = dm.simulate(
            job, commanded=commanded, adjoint=dm.process.ThroughPoses(), throw=False
        )
        return 1e12 * jnp.mean(ran.deviation**2)

    gradient = jax.jit(jax.grad(cost))(jnp.asarray(job.path.positions))
    corrected = dm.correct(job)
    found = {
        "tips": solution.actual,
        "force": solution.force,
        "gradient": gradient,
        "steps": jnp.stack([jnp.asarray(step.cost) for step in corrected.history]),
        "command": corrected.commanded,
    }
    for axis, rays in zip("xyz", solution.stock.families, strict=True):
        found[f"rays {axis}"] = rays.lengths()
    return {f"{name}: {kind}": np.asarray(x) for kind, x in found.items()}


def main() -> None:
    """Store or compare."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("what", choices=("store", "compare"))
    parser.add_argument("file", type=pathlib.Path)
    parser.add_argument("--jobs", nargs="+", choices=NAMES, default=NAMES)
    asked = parser.parse_args()
    report = Report("diffmill: six reference jobs")
    found = {}
    for name in asked.jobs:
        found |= numbers(name)
        report.say(f"{name} has run")
    if asked.what == "store":
        np.savez(asked.file, **found)
        return
    with np.load(asked.file) as wanted:
        for kind, value in found.items():
            size = np.abs(wanted[kind]).max()
            off = np.abs(value - wanted[kind]).max() / (size if size > 0 else 1.0)
            report.figure(kind, off, SAME, "")
    sys.exit(bool(report.missed))


if __name__ == "__main__":
    main()
