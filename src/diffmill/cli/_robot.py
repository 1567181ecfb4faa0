"""Description of a robot and its compliance: in words, as JSON, and drawn."""

import json
import pathlib
import warnings
from collections.abc import Callable
from importlib import resources
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .._jax_config import configure_jax
from .._messages import printable
from .._results_folder import ResultsFolder
from .._toml import parse_toml
from ._robot_facts import JointPositions, RobotFacts, robot_facts
from ._robot_text import robot_lines
from ._session.errors import bad_input, locked_folder
from ._session.progress import Progress

if TYPE_CHECKING:
    from ..robot import Robot


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
        pose: Joint positions as text; None for the robot's home, of a job for where
            it is half-way through the path.
        tool: Name of the tool; None if there is only one.
        drives: File with the joints' stiffness and damping; None for the robot's own.
        out: Folder for the results; None for `./<model>-robot`.
        force: Whether results that are there are replaced.
        progress: Shows how far it is.
        allow_outside: Whether a job may name files outside its folder.
    """
    folder = pathlib.Path(f"{pathlib.Path(model).stem}-robot") if out is None else out
    with bad_input():
        ResultsFolder.of(folder).check(force=force)
    # What takes seconds to import waits until it is needed.
    configure_jax()
    from ..io import parse_pose
    from ..robot import built_in_models, load, spindle_note

    with bad_input(), warnings.catch_warnings(record=True) as noted:
        warnings.simplefilter("always")
        if _is_job(pathlib.Path(model)):
            if tool is not None or drives is not None:
                raise ValueError(
                    f"{model}: found --tool or --drives beside a job; allowed: --pose, "
                    "since its table [robot] says the rest"
                )
            found = _robot_of_job(pathlib.Path(model), allow_outside=allow_outside)
            robot, q = found.robot, found.joints
        else:
            robot = load(model, tool=tool, drives=drives)
            q = np.asarray(robot.home, float)
        if pose is not None:
            try:
                q = parse_pose(pose, robot)
            except ValueError as error:
                raise ValueError(f"--pose: {error}") from error
    facts = robot_facts(robot, q)
    facts["notes"] += [str(item.message) for item in noted]
    if model in built_in_models():
        facts["notes"] += [_description(model)]
    note = spindle_note(model, drives)
    if note is not None and facts["modes"] is not None:
        facts["notes"].append(note)
    if not progress.is_quiet:
        print(printable("\n".join(robot_lines(facts))))
    with locked_folder(folder) as unlocked, progress:
        if unlocked:
            progress.say(f"note: {unlocked}")
        progress.update("figures")
        fill = _filler(robot, q, facts)
        ResultsFolder.of(folder).write(fill, force=force)
    progress.say(f"results: {folder}")
    return 0


def _description(model: str) -> str:
    """Return what the file of a built-in model says of it as a whole."""
    file = resources.files("diffmill.robot").joinpath("models", f"{model}.toml")
    return str(parse_toml(file.read_bytes())["description"])


def _is_job(file: pathlib.Path) -> bool:
    """Return whether a file is a job: its faults are told where it is read."""
    try:
        return {"stock", "robot"} <= set(parse_toml(file.read_bytes()))
    except (OSError, ValueError):
        return False


class _PosedRobot(NamedTuple):
    """A robot, and where its joints stand [rad or m], shape (joint,)."""

    robot: "Robot"
    joints: "JointPositions"


def _robot_of_job(file: pathlib.Path, *, allow_outside: bool) -> _PosedRobot:
    """Return the robot of a job, and its joints half-way through the path.

    Raises:
        ValueError: The job is faulty, or has no robot.
    """
    import jax.numpy as jnp

    from ..config import load_job
    from ..sim import JobKinematics

    job = load_job(file, allow_outside=allow_outside)
    if job.robot is None:
        raise ValueError(
            f"{file}: found a job without a robot; needed is one with [robot] model or "
            "file"
        )
    q = JobKinematics(job).joints(jnp.asarray(job.path.positions)).positions
    return _PosedRobot(job.robot, np.asarray(q[len(q) // 2], float))


def _filler(
    robot: "Robot", q: "JointPositions", facts: RobotFacts
) -> Callable[[pathlib.Path], None]:
    """Return what writes the table and the figures to a folder."""
    from ..robot import Skeleton, StiffnessMap
    from ..viz import plot_robot, plot_stiffness, save_figure

    def fill(folder: pathlib.Path) -> None:
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

    return fill
