"""All methods over parts and arms, and what only derivatives can do.

python experiments/correction/methods.py [--parts thin_wall] [--arms kuka_kr210_like]
    [--settings "flange spring"] [--steps 3] [--out FOLDER]

What is run is written to `methods_<parts>.txt` in the folder of the results.
"""

import argparse
import pathlib
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

import diffmill as dm
from diffmill import sim
from diffmill.toolpath import ContourStatistics
from part_jobs import ARMS, part_job
from parts import PARTS

SPRING = """
[robot.flange_spring]
rotary_stiffness = ["5e5 N*m/rad", "5e5 N*m/rad", "5e5 N*m/rad"]
mass = "30 kg"
center_of_mass = ["0 mm", "0 mm", "170 mm"]
inertia = ["0.75 kg*m^2", "0.75 kg*m^2", "0.2 kg*m^2"]
"""


@dataclass(frozen=True)
class Setting:
    """A job in which the inverse drive cannot do what is asked.

    Attributes:
        what: What is asked.
        part: Name of the part.
        correction: Settings of `[correction]`.
        robot: Tables below `[robot]`.
    """

    what: str
    part: str
    correction: dict[str, str]
    robot: str = ""


SETTINGS = (
    Setting("offset of 0.2 mm", "paper_small", {"max_offset": '"0.2 mm"'}),
    Setting("knots of 60 ms", "paper_small", {"knot_spacing": '"60 ms"'}),
    Setting("at most 1 m/s^2", "paper_small", {"max_acceleration": '"1 m/s^2"'}),
    Setting("gouge of 30 um", "paper_small", {"gouge": '"30 um"'}),
    Setting("segments", "paper_small", {"horizon": "600", "overlap": "256"}),
    Setting("flange spring", "paper_small", {}, SPRING),
    Setting("Adam", "paper_small", {"method": '"adam"', "max_steps": "100"}),
    # Which pose is the deepest over a point changes with the steps: more of them gain.
    Setting("surface", "paper_small", {"objective": '"surface"', "max_steps": "6"}),
    Setting(
        "surface after two passes",
        "thin_wall",
        {"objective": '"surface"', "finishing_only": "true"},
    ),
)

# One more than a job takes unless it asks for more: what is closer to the end converges
# slowly.
STEPS = 3
# Where a figure is missed, the row is run again so.
CLOSER = {"knots of 15 ms": {"knot_spacing": '"15 ms"'}}
# Runs of the machine that the optimiser may take.
RUNS = 40
RESULTS = pathlib.Path(__file__).parent / "results"
BASELINES = (
    "uncorrected",
    "mirror",
    "mirror_iterated",
    "input_shaper",
    "inverse_drive",
)


@dataclass(frozen=True)
class _Kept:
    """What all corrections of a table share.

    Attributes:
        cases: Baselines by part, arm and what they depend on.
        steps: Steps of the optimiser, where a setting asks for no others.
    """

    cases: dict[tuple[str, ...], Mapping[str, np.ndarray]]
    steps: int


def measure(
    report: Any,
    parts: tuple[str, ...] = tuple(PARTS),
    arms: tuple[str, ...] = ARMS,
    settings: tuple[str, ...] = tuple(setting.what for setting in SETTINGS),
    *,
    steps: int = STEPS,
) -> None:
    """Print all methods of every part on every arm, then the settings on the first."""
    kept = _Kept({}, steps)
    _head(report)
    for part in parts:
        for arm in arms:
            errors: list[float] = []
            found = _corrected(kept, part, arm, errors=errors)
            report.say(f"{part}, {arm}")
            _cases(report, found)
            is_met = _judge(report, found)
            _price(report, found, errors)
            if not is_met:
                _closer(report, kept, part, arm, found)
    if settings:
        report.say()
        report.say("what the inverse drive, computed without it, does not keep or see")
        _head(report)
    for setting in SETTINGS:
        if setting.what in settings:
            _setting(report, kept, setting)


def _corrected(
    kept: _Kept,
    part: str,
    arm: str,
    correction: dict[str, str] | None = None,
    robot: str = "",
    errors: list[float] | None = None,
) -> dm.Correction:
    """Correct a part; baselines are run once for all settings that they do not see.

    That after each step of the optimiser is added to `errors`.
    """
    settings = {"max_steps": str(kept.steps), **(correction or {})}
    key = (part, arm, settings.get("max_offset", ""), robot)
    # Which iterate of the mirror is the best depends on the rows that count.
    if "finishing_only" in settings:
        key = (*key, "finishing")
    # On segments the grid of the mirror sees the first of them only.
    if "horizon" in settings:
        key = (*key, "segments")

    def keep(arrays: Mapping[str, np.ndarray]) -> None:
        names = [f"method/{name}/" for name in BASELINES]
        kept.cases[key] = {k: arrays[k] for k in arrays if k.startswith(tuple(names))}

    began = time.perf_counter()

    def tell(message: str, rms: float) -> None:
        seconds = time.perf_counter() - began
        print(f"{seconds:8.0f} s  {message}: {1e6 * rms:.2f} um", file=sys.stderr)
        if errors is not None and message.startswith("Gauss-Newton step"):
            errors.append(rms)

    job = part_job(part, arm, correction=settings, robot=robot)
    return dm.correct(
        job, on_progress=tell, on_checkpoint=keep, resume=kept.cases.get(key)
    )


def _setting(report: Any, kept: _Kept, setting: Setting) -> None:
    """Print all methods where something is asked that the inverse drive cannot do."""
    errors: list[float] = []
    found = _corrected(
        kept, setting.part, ARMS[0], setting.correction, setting.robot, errors
    )
    report.say(f"{setting.what}: {setting.part}, {ARMS[0]}")
    data = _cases(report, found)
    # Where the surface counts too, the steps tell other errors.
    counts_surface = bool({"objective", "gouge"} & set(setting.correction))
    _price(report, found, [] if counts_surface else errors)
    key = "surface" if setting.correction.get("objective") else "path"
    error = {name: _error(data, name, key) for name in found.cases}
    report.at_least(
        f"inverse drive over Gauss-Newton, {key}",
        error["inverse_drive"] / error["corrected"],
        1,
    )
    if "horizon" in setting.correction:
        whole = _corrected(kept, setting.part, ARMS[0]).to_dataset()
        share = error["corrected"] / _error(whole, "corrected", key)
        what = "rms of the segments over that of the whole path"
        report.figure(what, share, 1.01, "")


def _closer(
    report: Any, kept: _Kept, part: str, arm: str, found: dm.Correction
) -> None:
    """Print what limits: chatter or knots."""
    job = part_job(part, arm)
    warning = sim.stability(job, found.before).warning()
    if warning:
        report.say(f"  {warning}")
    report.say("  what limits: the same with closer knots")
    for name, settings in CLOSER.items():
        found = _corrected(kept, part, arm, settings)
        data = found.to_dataset()
        error = {case: _error(data, case, "path") for case in found.cases}
        share = error["uncorrected"] / error["corrected"]
        report.say(
            f"  {name:24}{1e6 * error['corrected']:8.1f} um rms, uncorrected over it "
            f"{share:.3g}"
        )
        _left(report, found)


def _head(report: Any) -> None:
    report.say("contour and surface errors in um; acceleration of the command in m/s^2")
    report.say(
        f"{'case':16}{'rms':>8}{'95 %':>8}{'max':>8}{'wall95':>8}{'floor95':>8}"
        f"{'deepest':>8}{'m/s^2':>7}{'offset':>8}{'runs':>6}{'systems':>9}{'s':>8}"
    )


def _cases(report: Any, found: dm.Correction) -> Any:
    """Print a line for every case; return the dataset."""
    data = found.to_dataset()
    for name in found.cases:
        row = data.sel(case=name)
        contour = _contour(row)
        offset = np.abs(np.asarray(row["commanded"] - row["desired"])).max()
        errors = (
            contour.rms,
            contour.p95,
            contour.max,
            *(float(row.get(f"surface_{k}_p95", np.nan)) for k in ("wall", "floor")),
            float(row.get("surface_deepest", np.nan)),
        )
        report.say(
            f"{name:16}"
            + "".join(f"{1e6 * value:8.1f}" for value in errors)
            + f"{float(row['max_acceleration']):7.2f}{1e6 * offset:8.0f}"
            + f"{data.attrs[f'{name}_forward_runs']:6d}"
            + f"{data.attrs[f'{name}_linearisations']:9d}"
            + f"{data.attrs[f'{name}_wall_time_s']:8.1f}"
        )
    _left(report, found)
    return data


def _left(report: Any, found: dm.Correction) -> None:
    """Print where the corrected error is, and what the optimiser ended at."""
    error = np.linalg.norm(found.methods["corrected"].contour, axis=1)
    rms = found.path_parts.figures(error)["rms"]
    rows = ", ".join(
        f"{part} {1e6 * value:.1f}"
        for part, value in zip(found.path_parts.NAMES, rms, strict=True)
        if np.isfinite(value)
    )
    corrected = found.methods["corrected"]
    end = "settled" if corrected.result == dm.RESULTS.successful else "steps ran out"
    detail = corrected.detail
    report.say(f"  corrected, rms by part of the path [um]: {rows}")
    report.say(
        f"  {len(found.history)} steps, {end}; {detail['bound_count']:.0f} of "
        f"{detail['unknowns']:.0f} unknowns at the largest offset"
    )


def _judge(report: Any, found: dm.Correction) -> bool:
    """Print the three ratios that an unconstrained correction has to reach."""
    data = found.to_dataset()
    error = {name: _error(data, name, "path") for name in found.cases}
    mirror = min(error["mirror"], error["mirror_iterated"])
    is_met = True
    for what, other, least in (
        ("uncorrected", error["uncorrected"], 20),
        ("best mirror", mirror, 5),
        ("inverse drive", error["inverse_drive"], 1),
    ):
        ratio = other / error["corrected"]
        report.at_least(f"{what} over Gauss-Newton, rms", ratio, least)
        is_met &= ratio >= least
    return is_met


def _price(report: Any, found: dm.Correction, errors: list[float]) -> None:
    """Print the optimiser's time in runs, whole and to a twentieth of the error.

    A run is one of the mirror, which has compiled. A step's time is that of those after
    the first, which compiles; without segments nothing else takes long.
    """
    history = found.history
    mirror = found.methods["mirror_iterated"]
    run = found.wall_time["mirror_iterated"] / mirror.forward_runs
    whole = found.wall_time["corrected"] / run
    report.say(f"  optimiser with compilation: {whole:.3g} runs of {run:.3g} s")
    if len(history) < 2:
        report.say("  fewer than two steps: what compiling takes of it is not known")
        return
    first, last = history[0], history[-1]
    step = (last.seconds - first.seconds) / (len(history) - 1) / run
    what = f"optimiser without compilation, in runs ({len(history)} steps)"
    report.figure(what, len(history) * step, RUNS, "")
    least = 0.05 * found.methods["uncorrected"].measures.rms
    there = [k for k, rms in enumerate(errors) if rms <= least]
    if there:
        report.say(f"  of these to 5 % of the error: {(there[0] + 1) * step:.3g}")


def _error(data: Any, name: str, key: str) -> float:
    """Return the rms contour error, or the larger 95 % of wall and floor [m]."""
    row = data.sel(case=name)
    if key == "path":
        return _contour(row).rms
    found = [float(row[f"surface_{k}_p95"]) for k in ("wall", "floor")]
    return float(np.nanmax(found))


def _contour(row: Any) -> ContourStatistics:
    """Contour error where the tool cuts."""
    return ContourStatistics.of(row["contour_error"].values, row["is_cutting"].values)


def main() -> None:
    """Run some parts on some arms."""
    import jax

    jax.config.update("jax_enable_x64", True)
    dm.use_compile_cache()
    sys.path.append(str(pathlib.Path(__file__).parents[1] / "common"))
    from reporting import Report, store

    names = [setting.what for setting in SETTINGS]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--parts", nargs="*", default=[], choices=PARTS)
    parser.add_argument("--arms", nargs="*", default=ARMS, choices=ARMS)
    parser.add_argument("--settings", nargs="*", default=[], choices=names)
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--out", type=pathlib.Path, default=RESULTS)
    chosen = parser.parse_args()
    if not (chosen.parts or chosen.settings):
        parser.error("found neither --parts nor --settings; `run.py methods` runs all")
    report = Report("diffmill correction: methods")
    print("\n".join(report.lines), flush=True)
    rows = tuple(chosen.parts), tuple(chosen.arms), tuple(chosen.settings)
    measure(report, *rows, steps=chosen.steps)
    shown = [*chosen.parts, *(["settings"] if chosen.settings else [])]
    if tuple(chosen.arms) != ARMS:
        shown += chosen.arms
    store(report, chosen.out, "_".join(["methods", *shown]))


if __name__ == "__main__":
    main()
