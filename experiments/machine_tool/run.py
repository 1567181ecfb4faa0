"""A machine tool given by measured modes: deviation, correction and growth of chatter.

Run from the root of the repository: python experiments/machine_tool/run.py
"""

import pathlib

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

import diffmill as dm  # noqa: E402


def main() -> None:
    """Print the figures of the job `slot.toml` beside this file."""
    job = dm.load_job(pathlib.Path(__file__).with_name("slot.toml"))
    for note in job.notes:
        print(f"note: {note}")
    correction = dm.correct(job)
    print(f"{'case':<16}{'rms':>10}{'largest':>10}  contour error in the cut [um]")
    for name, found in correction.methods.items():
        measures = found.measures
        print(f"{name:<16}{1e6 * measures.rms:>10.3f}{1e6 * measures.max:>10.3f}")
    force = np.linalg.norm(np.asarray(correction.before.force), axis=1)
    print(f"largest mean force of a tooth period: {force.max():.2f} N")
    growth = dm.sim.stability(job, correction.before)
    print(f"largest growth of a vibration per tooth period: {growth.radius.max():.3f}")


if __name__ == "__main__":
    main()
