"""A model that is wrong: corrections judged on machines that they never saw.

python experiments/correction/mismatch.py [--draws 50] [--no-worst] [--out FOLDER]
"""

import argparse
import pathlib
import sys
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import diffmill as dm
from diffmill import process as pr
from diffmill.correction import Ensemble, ScaledPlant, TipPlant, delayed
from diffmill.toolpath import contour_error
from small_job import small_job

WRONG, DRAWS, SEED = 0.2, 50, 12345
ALL = 'compare = "all"\n'
UNCERTAIN = (
    f"[correction.uncertainty]\nstiffness = {WRONG}\ndamping = {WRONG}\n"
    f"force = {WRONG}\ndraws = 4\nseed = 1\n"
)
WORST = 'objective = "worst"\n'
# Runs of all members that a correction may take, without compilation.
RUNS = 40
# What is wrong one at a time: how parameters that begin so are scaled.
KINDS = {"stiffness K": "K ", "damping D": "D ", "force": None}
CHANGES = (-0.4, -0.2, -0.1, 0.1, 0.2, 0.4)
DELAYS = (0.0, 5e-3, 10e-3, 20e-3)
# Error of every row that cuts, for the logarithms of all scales and a command.
Errors = Callable[[Any, Any], np.ndarray]
Commands = dict[str, Any]


def measure(
    report: Any,
    jobs: tuple[dm.Job, dm.Job, dm.Job] | None = None,
    draws: int = DRAWS,
    *,
    has_worst: bool = True,
) -> None:
    """Print the error of every command on wrong models."""
    nominal, uncertain, worst = jobs or (
        small_job(ALL),
        small_job(ALL + UNCERTAIN),
        small_job(ALL + UNCERTAIN + WORST),
    )
    kept: dict[str, np.ndarray] = {}

    def keep(arrays: Mapping[str, np.ndarray]) -> None:
        # The baselines know of no uncertainty, and are run once.
        kept.update({k: arrays[k] for k in arrays if k.startswith("method/")})

    found = dm.correct(nominal, on_checkpoint=keep)
    commands = {name: case.commanded for name, case in found.cases.items()}
    mirror = found.methods["mirror_iterated"]
    run = found.wall_time["mirror_iterated"] / mirror.forward_runs
    commands["robust"] = _timed(report, "robust", uncertain, kept, run)
    if has_worst:
        commands["worst case"] = _timed(report, "worst case", worst, kept, run)
    errors = _errors(nominal, found)
    _random(report, nominal, errors, commands, draws)
    _members(report, uncertain, errors, commands)
    _one_at_a_time(report, nominal, errors, commands)
    _late(report, nominal, errors, commands)


def _timed(
    report: Any, name: str, job: dm.Job, kept: Mapping[str, np.ndarray], run: float
) -> jax.Array:
    """Return the corrected command, and print its price.

    Args:
        report: Where it is printed.
        name: Of the correction.
        job: The job.
        kept: What is known of its baselines.
        run: One run of one machine [s], by the iterated mirror, whose program the
            mirror before it has compiled.
    """
    found = dm.correct(job, resume=kept)
    history = found.history
    known = job.correction.uncertainty
    assert known is not None
    first, last, members = history[0], history[-1], known.draws
    report.say(
        f"{name}: {last.models} linear systems of all members, {last.seconds:.0f} s, "
        f"of which {first.seconds:.0f} s until the first step has ended"
    )
    if len(history) > 1:
        # Each step as long as those after the first, and one for the linear system
        # that the first began with: what compiles is left out.
        step = (last.seconds - first.seconds) / (len(history) - 1)
        runs = (len(history) + 1) * step / run
        report.say(f"{name}: {runs:.3g} runs of one machine ({run:.3g} s)")
        what = f"{name}, in runs of its {members} members ({len(history)} steps)"
        report.figure(what, runs / members, RUNS, "")
    return found.commanded


def _errors(job: dm.Job, found: dm.Correction) -> Errors:
    cutting = np.asarray(found.before.is_cutting)
    desired = jnp.asarray(job.path.positions)
    plant = ScaledPlant(TipPlant(job.with_precision(), pr.ThroughPoses()))

    @jax.jit
    def every(scale: jax.Array, command: jax.Array) -> jax.Array:
        return contour_error(plant.member(scale)(command).actual, desired)

    return lambda scale, command: np.asarray(
        every(jnp.asarray(scale), jnp.asarray(command))
    )[cutting]


def _rms(each: Any) -> Any:
    return np.sqrt(np.mean(np.square(each), axis=-1))


def _random(
    report: Any, job: dm.Job, errors: Errors, commands: Commands, draws: int
) -> None:
    """Print the errors over draws of all parameters."""
    scales = Ensemble.draw_scales(
        job.parameter_names,
        count=draws,
        seed=SEED,
        stiffness=WRONG,
        damping=WRONG,
        force=WRONG,
    )
    report.say(
        f"contour error [um] over {draws} draws of stiffness, damping and force "
        f"coefficients, each +-{100 * WRONG:.0f} %"
    )
    report.say(f"{'command':16}{'rms':>10}{'95 %':>10}{'worst rms':>12}")
    p95 = {}
    for name, command in commands.items():
        each = np.stack([errors(scale, command) for scale in scales])
        p95[name] = float(np.percentile(each, 95))
        report.say(
            f"{name:16}{1e6 * np.sqrt(np.mean(each**2)):10.1f}{1e6 * p95[name]:10.1f}"
            f"{1e6 * _rms(each).max():12.1f}"
        )
    best_mirror = min(p95["mirror"], p95["mirror_iterated"])
    for what, other in (
        ("the nominal correction", p95["corrected"]),
        ("the best mirror", best_mirror),
    ):
        report.at_least(f"95 % of {what} over robust", other / p95["robust"], 1)


def _members(report: Any, job: dm.Job, errors: Errors, commands: Commands) -> None:
    """Print the errors of the members that the robust corrections were made with."""
    known = job.correction.uncertainty
    assert known is not None
    scales = Ensemble.draw_scales(
        job.parameter_names,
        count=known.draws,
        seed=known.seed,
        stiffness=known.stiffness,
        damping=known.damping,
        force=known.force,
    )
    report.say()
    report.say("rms contour error [um] of the members of the ensemble itself")
    largest = {}
    for name in [n for n in ("corrected", "robust", "worst case") if n in commands]:
        each = [float(_rms(errors(scale, commands[name]))) for scale in scales]
        largest[name] = max(each)
        report.say(f"{name:16}" + "".join(f"{1e6 * value:10.1f}" for value in each))
    if "worst case" in largest:
        report.at_least(
            "worst member, mean over worst case",
            largest["robust"] / largest["worst case"],
            1,
        )


def _head(report: Any, what: str, commands: Commands) -> None:
    report.say()
    report.say(f"rms contour error [um], {what}")
    report.say(f"{'':24}" + "".join(f"{name:>16}" for name in commands))


def _row(report: Any, name: str, each: list[Any]) -> None:
    report.say(f"{name:24}" + "".join(f"{1e6 * float(_rms(e)):16.1f}" for e in each))


def _one_at_a_time(
    report: Any, job: dm.Job, errors: Errors, commands: Commands
) -> None:
    """Print the errors where one kind of parameter is wrong by a stated amount."""
    names = job.parameter_names
    _head(report, "one kind of parameter wrong", commands)
    for kind, start in KINDS.items():
        is_kind = [
            name != "speed"
            and (name[:2] not in ("K ", "D ") if start is None else name[:2] == start)
            for name in names
        ]
        for change in CHANGES:
            scale = np.log1p(change) * np.array(is_kind, float)
            each = [errors(scale, command) for command in commands.values()]
            _row(report, f"{kind} {100 * change:+.0f} %", each)


def _late(report: Any, job: dm.Job, errors: Errors, commands: Commands) -> None:
    """Print the errors where the command, or only its offset, is carried out late."""
    step = float(job.tooth_period)
    path = np.asarray(job.path.positions)
    right = np.zeros(len(job.parameter_names))
    for what, nominal in (("the whole command late", None), ("its offset late", path)):
        _head(report, what, commands)
        for delay in DELAYS:
            late = [
                delayed(command, delay, step, nominal=nominal)
                for command in commands.values()
            ]
            each = [errors(right, command) for command in late]
            _row(report, f"delay {1e3 * delay:.0f} ms", each)


def main() -> None:
    """Run some draws, with or without the worst case."""
    jax.config.update("jax_enable_x64", True)
    dm.use_compile_cache()
    here = pathlib.Path(__file__).parent
    sys.path.append(str(here.parent / "common"))
    from reporting import Report, store

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=DRAWS)
    parser.add_argument("--no-worst", action="store_true")
    parser.add_argument("--out", type=pathlib.Path, default=here / "results")
    chosen = parser.parse_args()
    report = Report("diffmill correction: mismatch")
    print("\n".join(report.lines), flush=True)
    measure(report, None, chosen.draws, has_worst=not chosen.no_worst)
    store(report, chosen.out, "mismatch")


if __name__ == "__main__":
    main()
