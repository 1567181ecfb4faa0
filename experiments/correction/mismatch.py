"""A model that is wrong: corrections judged on draws of it that they never saw."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import diffmill as dm
from diffmill import sim
from diffmill.correction import ScaledPlant, draw_scales
from diffmill.toolpath import contour_error
from small_job import small_job

WRONG, DRAWS, SEED = 0.2, 50, 12345
UNCERTAIN = (
    f"[correction.uncertainty]\nstiffness = {WRONG}\ndamping = {WRONG}\n"
    f"force = {WRONG}\ndraws = 4\nseed = 1\n"
)


def measure(
    report: Any,
    jobs: tuple[dm.Job, dm.Job] | None = None,
    draws: int = DRAWS,
) -> None:
    """Print the error of every command over draws of the model."""
    nominal, uncertain = jobs or (small_job(), small_job(UNCERTAIN))
    found = dm.correct(nominal)
    commands = {name: case.commanded for name, case in found.cases.items()}
    commands["robust"] = dm.correct(uncertain).commanded
    names = sim.parameter_names(nominal)
    scales = draw_scales(
        names,
        count=draws,
        seed=SEED,
        stiffness=WRONG,
        damping=WRONG,
        force=WRONG,
    )
    cutting = np.asarray(found.before.is_cutting)
    desired = jnp.asarray(nominal.path.positions)
    plant = ScaledPlant(sim.with_precision(nominal), sim.Traced())

    @jax.jit
    def errors(scale: jax.Array, command: jax.Array) -> jax.Array:
        return contour_error(plant(scale, command).actual, desired)

    report.say(
        f"contour error [um] over {draws} draws of stiffness, damping and force "
        f"coefficients, each +-{100 * WRONG:.0f} %"
    )
    report.say(f"{'command':16}{'rms':>10}{'95 %':>10}{'worst rms':>12}")
    p95 = {}
    for name, command in commands.items():
        each = [np.asarray(errors(jnp.asarray(s), command))[cutting] for s in scales]
        rms = np.sqrt(np.mean(np.square(each), axis=1))
        p95[name] = float(np.percentile(each, 95))
        report.say(
            f"{name:16}{1e6 * np.sqrt(np.mean(rms**2)):10.1f}{1e6 * p95[name]:10.1f}"
            f"{1e6 * rms.max():12.1f}"
        )
    report.at_least(
        "95 % of the nominal correction over robust",
        p95["corrected"] / p95["robust"],
        1,
    )
    report.at_least(
        "95 % of the best mirror over robust",
        min(p95["mirror"], p95["mirror_iterated"]) / p95["robust"],
        1,
    )
