"""All methods over parts and arms, and what only derivatives can do.

python experiments/correction/methods.py [--parts thin_wall] [--arms kuka_kr210_like]
    [--settings "flange spring"]
"""

import argparse
import pathlib
import sys
from dataclasses import dataclass
from typing import Any

import numpy as np

import diffmill as dm
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
    Setting("flange spring", "paper_small", {}, SPRING),
    Setting("surface", "paper_small", {"objective": '"surface"'}),
    Setting(
        "surface after two passes",
        "thin_wall",
        {"objective": '"surface"', "finishing_only": "true"},
    ),
)


def measure(
    report: Any,
    parts: tuple[str, ...] = tuple(PARTS),
    arms: tuple[str, ...] = ARMS,
    settings: tuple[str, ...] = tuple(setting.what for setting in SETTINGS),
) -> None:
    """Print all methods of every part on every arm, then the settings on the first."""
    _head(report)
    for part in parts:
        for arm in arms:
            data = dm.correct(part_job(part, arm)).to_dataset()
            _cases(report, f"{part}, {arm}", data)
            _judge(report, data)
    report.say()
    report.say("what the inverse drive, computed without it, does not keep or see")
    _head(report)
    for setting in SETTINGS:
        if setting.what not in settings:
            continue
        job = part_job(
            setting.part, arms[0], correction=setting.correction, robot=setting.robot
        )
        data = dm.correct(job).to_dataset()
        _cases(report, f"{setting.what}: {setting.part}, {arms[0]}", data)
        key = "surface" if setting.correction.get("objective") else "path"
        found = {name: _error(data, name, key) for name in data["case"].values}
        report.at_least(
            f"inverse drive over Gauss-Newton, {key}",
            found["inverse_drive"] / found["corrected"],
            1,
        )


def _head(report: Any) -> None:
    report.say("contour and surface errors in um; acceleration of the command in m/s^2")
    report.say(
        f"{'case':16}{'rms':>8}{'95 %':>8}{'max':>8}{'wall95':>8}{'floor95':>8}"
        f"{'m/s^2':>7}{'offset':>8}{'runs':>6}{'products':>9}{'s':>8}"
    )


def _cases(report: Any, title: str, data: Any) -> None:
    """Print a line for every case."""
    report.say(title)
    for name in data["case"].values:
        row = data.sel(case=name)
        error = _contour(row)
        offset = np.abs(np.asarray(row["commanded"] - row["desired"])).max()
        errors = (
            np.sqrt(np.mean(error**2)),
            np.percentile(error, 95),
            error.max(),
            *(float(row.get(f"surface_{k}_p95", np.nan)) for k in ("wall", "floor")),
        )
        report.say(
            f"{name:16}"
            + "".join(f"{1e6 * value:8.1f}" for value in errors)
            + f"{float(row['max_acceleration']):7.2f}{1e6 * offset:8.0f}"
            + f"{data.attrs[f'{name}_forward_runs']:6d}"
            + f"{data.attrs[f'{name}_products']:9d}"
            + f"{data.attrs[f'{name}_wall_time_s']:8.1f}"
        )


def _judge(report: Any, data: Any) -> None:
    """Print the three ratios that an unconstrained correction has to reach."""
    found = {name: _error(data, name, "path") for name in data["case"].values}
    mirror = min(found["mirror"], found["mirror_iterated"])
    for what, other, least in (
        ("uncorrected", found["uncorrected"], 20),
        ("best mirror", mirror, 5),
        ("inverse drive", found["inverse_drive"], 1),
    ):
        report.at_least(
            f"{what} over Gauss-Newton, rms", other / found["corrected"], least
        )


def _error(data: Any, name: str, key: str) -> float:
    """Return the rms contour error, or the larger 95 % of wall and floor [m]."""
    row = data.sel(case=name)
    if key == "path":
        return float(np.sqrt(np.mean(_contour(row) ** 2)))
    found = [float(row[f"surface_{k}_p95"]) for k in ("wall", "floor")]
    return float(np.nanmax(found))


def _contour(row: Any) -> np.ndarray:
    """Return the contour errors where the tool cuts [m]."""
    is_cutting = np.asarray(row["is_cutting"], bool)
    return np.abs(np.asarray(row["contour_error"], float))[is_cutting]


def main() -> None:
    """Run some parts on some arms."""
    import jax

    jax.config.update("jax_enable_x64", True)
    sys.path.append(str(pathlib.Path(__file__).parents[1] / "common"))
    from reporting import Report

    names = [setting.what for setting in SETTINGS]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--parts", nargs="*", default=[], choices=PARTS)
    parser.add_argument("--arms", nargs="*", default=ARMS, choices=ARMS)
    parser.add_argument("--settings", nargs="*", default=[], choices=names)
    chosen = parser.parse_args()
    report = Report("diffmill correction: methods")
    measure(report, tuple(chosen.parts), tuple(chosen.arms), tuple(chosen.settings))
    print(report.text().splitlines()[-1])


if __name__ == "__main__":
    main()
