"""Description of a robot and its compliance: in words, as JSON, and drawn."""

import json
import pathlib
import warnings
from importlib import resources
from typing import TYPE_CHECKING

import numpy as np

from ..._jax_config import configure_jax
from ..._messages import printable
from ..._results_folder import ResultsFolder
from ..._toml import parse_toml
from .._check import tables_of
from .._session.errors import bad_input, locked_folder
from .._session.progress import Progress
from .facts import JointPositions, RobotFacts, robot_facts
from .text import robot_lines

if TYPE_CHECKING:
    from ...robot import Robot


def run_robot(
    model: str,
    *,
    pose: str | None,
    tool: str | None,
    drives: pathlib.Path | None = None,
    out: pathlib.Path | None,
    force: bool,
    progress: Progress,
    allow_outside: bool = False,
) -> int:
    """Describe a robot and write a folder with its figures; return the exit code.

    Args:
        model: Name of a built-in model, a robot file, or a job, whose robot carries
            its tool, spindle and bending cutter.
        pose: Joint positions as text; None for the robot's home, of a job for the pose
            half-way through the path.
        tool: Name of the tool; None if there is only one.
        drives: File with the joints' stiffness and damping; None for the robot's own.
        out: Folder for the results; None for `./<model>-robot`.
        force: True to replace results that are there.
        progress: Display of the progress.
        allow_outside: True if a job may name files outside its folder.
    """
    folder = pathlib.Path(f"{pathlib.Path(model).stem}-robot") if out is None else out
    with bad_input():
        ResultsFolder.of(folder).check(force=force)
    # Imports that take seconds wait until they are needed.
    configure_jax()
    from ...io import parse_pose
    from ...robot import built_in_models, drive_classes, load, spindle_note

    with bad_input(), warnings.catch_warnings(record=True) as load_warnings:
        warnings.simplefilter("always")
        if {"stock", "robot"} <= set(tables_of(pathlib.Path(model))):
            if tool is not None or drives is not None:
                raise ValueError(
                    f"{model}: found --tool or --drives beside a job; allowed: --pose, "
                    "since its table [robot] says the rest"
                )
            robot, q = _robot_of_job(pathlib.Path(model), allow_outside=allow_outside)
        else:
            robot = load(model, tool=tool, drives=drives)
            q = np.asarray(robot.home, float)
        if pose is not None:
            try:
                q = parse_pose(pose, robot)
            except ValueError as error:
                raise ValueError(f"--pose: {error}") from error
    facts = robot_facts(robot, q)
    facts["notes"] += [str(item.message) for item in load_warnings]
    if model in built_in_models():
        file = resources.files("diffmill.robot").joinpath("models", f"{model}.toml")
        facts["notes"].append(str(parse_toml(file.read_bytes())["description"]))
    if (assumed := drive_classes().get(str(drives))) is not None:
        facts["notes"].append(assumed.note())
    note = spindle_note(model, drives)
    if note is not None and facts["modes"] is not None:
        facts["notes"].append(note)
    if not progress.is_quiet:
        print(printable("\n".join(robot_lines(facts))))
    with locked_folder(folder) as unlocked, progress:
        if unlocked:
            progress.write(f"note: {unlocked}")
        progress.update("figures")
        ResultsFolder.of(folder).write(
            lambda target: _write_results(target, robot, q, facts), force=force
        )
    progress.write(f"results: {folder}")
    return 0


def _robot_of_job(
    file: pathlib.Path, *, allow_outside: bool
) -> "tuple[Robot, JointPositions]":
    """Robot of a job, and its joints half-way through the path [rad or m].

    Raises:
        ValueError: The job is faulty, or has no robot.
    """
    import jax.numpy as jnp

    from ...config import load_job
    from ...sim import JobKinematics

    job = load_job(file, allow_outside=allow_outside)
    if job.robot is None:
        raise ValueError(
            f"{file}: found a job without a robot; needed is one with [robot] model or "
            "file"
        )
    q = JobKinematics(job).joints(jnp.asarray(job.path.positions)).positions
    return job.robot, np.asarray(q[len(q) // 2], float)


def _write_results(
    folder: pathlib.Path, robot: "Robot", q: "JointPositions", facts: RobotFacts
) -> None:
    """Write the table and the figures to a folder."""
    from ...robot import Skeleton, StiffnessMap
    from ...viz import plot_robot, plot_stiffness, save_figure

    text = json.dumps(facts, indent=2, allow_nan=False)
    (folder / "robot.json").write_text(text + "\n", encoding="utf-8")
    bones = Skeleton.of_robot(robot, q)
    title = f"{robot.name}: {facts['mass_kg']:.0f} kg in motion"
    save_figure(plot_robot(robot, bones, title=title), folder / "robot.png")
    if facts["statics"] is None:
        return
    maps = [StiffnessMap.around(robot, q, plane=plane) for plane in ("xz", "xy")]
    if not any(np.isfinite(item.stiffness).any() for item in maps):
        return
    title = f"{robot.name}: the tool keeps its direction; grey: not reached so"
    figure = plot_stiffness(robot, bones, maps, title=title)
    save_figure(figure, folder / "stiffness.png")
