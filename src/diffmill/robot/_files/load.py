"""Read robots from files: the only module of this subpackage that touches files."""

import os
import warnings
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

import equinox as eqx
import numpy as np

from ..._arrays import on_device
from ..._toml import parse_toml
from .._model.build import build
from .._model.robot import Robot
from .drive_classes import drive_classes
from .errors import RobotFileError, RobotFileWarning
from .setup import SPINDLE, MountedElements, apply_setup
from .toml import read_elements
from .urdf import read_urdf

# Many a URDF is called .xml.
_URDF_SUFFIXES = (".urdf", ".xml")
# Least mass that a joint of a machine moves [kg].
_LEAST_MOVED_MASS = 1e-2
# Tables of a job file.
_JOB_TABLES = {"cutter", "program", "robot", "stock", "spindle"}


def built_in_models() -> list[str]:
    """Names of the models that come with the package."""
    folder = resources.files("diffmill.robot").joinpath("models")
    names = [entry.name for entry in folder.iterdir()]
    return sorted(n.removesuffix(".toml") for n in names if n.endswith(".toml"))


def load(
    model_or_file: str | os.PathLike[str],
    *,
    tool: str | None = None,
    drives: str | os.PathLike[str] | None = None,
) -> Robot:
    """Robot from a built-in model, a TOML file or a URDF.

    A URDF says nothing of springs: its joints are rigid until `drives`, the job or
    `with_drives` make them soft. Its links are merged where joints are fixed, its
    joints named in `joint_names` depth-first, children in the order of their joints'
    names. A mimicking joint moves its link, but is not counted. Effort,
    damping and friction are not used.

    Args:
        model_or_file: Name of a built-in model, or path of a robot file (.toml or
            .urdf).
        tool: Name of the tool to use, in a URDF of the link whose frame it is; may be
            left out if there is only one, in a URDF if only one link carries no other.
        drives: Name of one of `drive_classes`, such as "class 200 kg", for a robot
            without springs; or path of a TOML file that completes the robot's own:
            tables `stiffness` and `damping`, the joints' names as keys and quantities
            such as "3 MN*m/rad" as values; `drive`, with a table per joint; `locked`,
            the positions of joints that cannot move; `spindle`, the body at the flange;
            and `base_rpy`, the orientation of the base where gravity points down.

    Returns:
        The robot; its arrays have the floating point type that is JAX's default at
        the time of the call.

    Raises:
        ValueError: If there is no such model or file, or the file is faulty; a
            `RobotFileError` lists all faults at once.

    Warns:
        RobotFileWarning: If a robot is usable for kinematics only, because joints move
            no mass, or they move next to none; or a URDF has inertias that no body has.

    **Differentiability**: none; differentiate by the arrays of the `Robot`.
    """
    file = os.fspath(model_or_file)
    is_urdf = Path(file).suffix.lower() in _URDF_SUFFIXES
    if is_urdf:
        description = read_urdf(_read_file(file), file, tool)
    else:
        document = _parse(_read_model(file), file)
        if "elements" not in document and _JOB_TABLES & set(document):
            raise RobotFileError(
                f"{file}: this is a job, not a robot description (which has `name` and "
                "`elements`); its robot is what its table [robot] names, which "
                "`diffmill robot` and `load_job` take with its tool."
            )
        description = read_elements(document, file)
    mounted = MountedElements(description.elements, np.eye(3))
    side = "" if drives is None else os.fspath(drives)
    drive_class = drive_classes().get(side)
    if side and drive_class is None:
        setup = _parse(_read_file(side), side)
        mounted = apply_setup(setup, side, description.elements, tool)
    try:
        robot = build(mounted.elements, tool=tool, name=description.name)
        if drive_class is not None:
            robot = drive_class.applied_to(robot)
    except ValueError as error:
        raise RobotFileError(f"{file}: {error}") from error
    _warn(robot, description.notes, file)
    gravity = on_device(mounted.base.T.astype(robot.dtype) @ np.asarray(robot.gravity))
    return eqx.tree_at(lambda r: r.gravity, robot, gravity)


def spindle_note(
    model_or_file: str | os.PathLike[str], drives: str | os.PathLike[str] | None
) -> str | None:
    """Note on a spindle that neither a URDF nor its drives' file describes, else None.

    Args:
        model_or_file: Argument of `load`, which has read it.
        drives: Argument of `load`.
    """
    is_urdf = Path(model_or_file).suffix.lower() in _URDF_SUFFIXES
    side = "" if drives is None else os.fspath(drives)
    has_file = side and side not in drive_classes()
    if not is_urdf or (has_file and SPINDLE in _parse(_read_file(side), side)):
        return None
    return (
        "the spindle counts only where a link of the URDF has its mass; else give "
        "mass, center_of_mass and inertia in a table [spindle] of the drives' file"
    )


def _warn(robot: Robot, notes: Sequence[str], file: str) -> None:
    """Warn once of all that is doubtful in a file."""
    massless = robot.massless_joints
    light = [
        name for name in robot.light_joints(_LEAST_MOVED_MASS) if name not in massless
    ]
    if light:
        notes = [
            f"joints {', '.join(light)} move less than {1e3 * _LEAST_MOVED_MASS:g} g: "
            "no simulation follows how fast they swing",
            *notes,
        ]
    if massless:
        notes = [
            "usable for kinematics only: the mass matrix is singular, as nothing with "
            f"mass or inertia hangs on the joints {', '.join(massless)}",
            *notes,
        ]
    if notes:
        text = f"{file}: " + "; ".join(notes)
        warnings.warn(text, RobotFileWarning, stacklevel=3)


def _read_model(file: str) -> bytes:
    """Bytes of a built-in model or of a TOML file."""
    if file in built_in_models():
        model = resources.files("diffmill.robot").joinpath("models", f"{file}.toml")
        return model.read_bytes()
    if Path(file).suffix.lower() == ".xacro":
        raise ValueError(
            f"found {file!r}, a xacro file: expand its macros first "
            "(xacro FILE > robot.urdf) and give the URDF"
        )
    if Path(file).suffix.lower() != ".toml":
        raise ValueError(
            f"found {file!r}, which is neither a built-in model nor a file of a known "
            f"kind: {_choices()}"
        )
    return _read_file(file)


def _read_file(file: str) -> bytes:
    """Bytes of a file."""
    try:
        return Path(file).read_bytes()
    except OSError as error:
        raise ValueError(
            f"The robot file {file!r} cannot be read ({error}): {_choices()}."
        ) from error


def _choices() -> str:
    return (
        f"the built-in models are {', '.join(built_in_models())}; a file must be a "
        "robot description in TOML (.toml) or a URDF (.urdf)"
    )


def _parse(data: bytes, file: str) -> dict[str, object]:
    """Parsed TOML."""
    try:
        return parse_toml(data)
    except ValueError as error:
        raise RobotFileError(f"{file}: {error}") from error
