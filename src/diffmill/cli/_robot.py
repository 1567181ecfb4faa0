"""Description of a robot and its compliance: in words, as JSON, and drawn."""

import json
import pathlib
import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from .._jax_config import configure_jax
from .._results_folder import ResultsFolder
from .._toml import parse_toml
from ._robot_text import robot_lines
from ._session.errors import bad_input
from ._session.progress import Progress

if TYPE_CHECKING:
    from jaxtyping import Complex, Float

    from ..robot import Robot

    # jaxtyping checks what it can see; at run time nothing of the kind is imported.
    JointPositions = Float[np.ndarray, " joint"]
    ComplexShape = Complex[np.ndarray, " 3"]
else:
    JointPositions = ComplexShape = Any

_LOAD_N = 100.0


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
    from ..robot import load, spindle_note

    with bad_input(), warnings.catch_warnings(record=True) as noted:
        warnings.simplefilter("always")
        if _is_job(pathlib.Path(model)):
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
    facts["notes"] += [str(item.message) for item in noted]
    note = spindle_note(model, drives)
    if note is not None and facts["modes"] is not None:
        facts["notes"].append(note)
    if not progress.is_quiet:
        print("\n".join(robot_lines(facts)))
    with progress:
        progress.update("figures")
        fill = _filler(robot, q, facts)
        ResultsFolder.of(folder).write(fill, force=force)
    progress.say(f"results: {folder}")
    return 0


def _is_job(file: pathlib.Path) -> bool:
    """Return whether a file is a job: its faults are told where it is read."""
    try:
        return {"stock", "robot"} <= set(parse_toml(file.read_bytes()))
    except (OSError, ValueError):
        return False


def _robot_of_job(
    file: pathlib.Path, *, allow_outside: bool
) -> "tuple[Robot, JointPositions]":
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
    return job.robot, np.asarray(q[len(q) // 2], float)


def robot_facts(robot: "Robot", q: "JointPositions") -> dict[str, Any]:
    """Return what there is to say about a robot at a pose, with units in the keys.

    Args:
        robot: The robot.
        q: Joint positions [rad or m], shape (joint,).

    Returns:
        Numbers, lists and texts only; what does not exist is None.
    """
    from ..robot import forward_kinematics

    T = np.asarray(forward_kinematics(robot, q))
    K = np.asarray(robot.joint_stiffness)
    is_soft = bool(np.isfinite(K).any())
    notes, modes = [], None
    if is_soft:
        try:
            modes = _modes(robot, q)
        except ValueError as error:
            notes.append(str(error))
    silent = int(np.isfinite(K).sum()) - len(modes or [])
    if modes is not None and silent:
        notes.append(
            f"modes that do not oscillate, so strong are their dampers: {silent}"
        )
    if np.isinf(K).all():
        notes.append(
            "no joint has a spring, so nothing bends; give the joints stiffness and "
            "damping in a robot file, in a file for --drives, or in a job with drives, "
            "joint_stiffness and joint_damping"
        )
    elif np.isinf(K).any():
        rigid = [n for n, k in zip(robot.joint_names, K, strict=True) if np.isinf(k)]
        notes.append(f"joints without a spring, taken as rigid: {', '.join(rigid)}")
    return {
        "model": robot.name,
        "joints": _joints(robot, q),
        "mass_kg": float(np.sum(np.asarray(robot.link_masses))),
        "tool_position_mm": (1e3 * T[:3, 3]).tolist(),
        "tool_axis": T[:3, 2].tolist(),
        "statics": _statics(robot, q) if is_soft else None,
        "modes": modes,
        "notes": notes,
    }


def _joints(robot: "Robot", q: "JointPositions") -> list[dict[str, Any]]:
    """Return a row per joint: degrees and N m/rad, or millimetres and N/m."""
    rows = []
    for k, (name, kind) in enumerate(
        zip(robot.joint_names, robot.joint_kinds, strict=True)
    ):
        slides = kind == "prismatic"
        scale, unit = (1e3, "mm") if slides else (180.0 / np.pi, "deg")
        rows.append(
            {
                "name": name,
                "kind": f"virtual {kind}" if robot.is_virtual[k] else kind,
                "unit": unit,
                "position": float(q[k]) * scale,
                "lower": _finite(float(robot.joint_lower[k]) * scale),
                "upper": _finite(float(robot.joint_upper[k]) * scale),
                "stiffness": _finite(float(robot.joint_stiffness[k])),
                "stiffness_unit": "N/m" if slides else "N m/rad",
                "damping": float(robot.joint_damping[k]),
                "damping_unit": "N s/m" if slides else "N m s/rad",
            }
        )
    return rows


def _finite(value: float) -> float | None:
    """Return a value as JSON can hold it: None for infinity."""
    return value if np.isfinite(value) else None


def _statics(robot: "Robot", q: "JointPositions") -> dict[str, object]:
    """Return stiffness, deflection and sag of the tool's tip."""
    from ..robot import cartesian_compliance, gravity_sag, static_deflection

    C = np.asarray(cartesian_compliance(robot, q))[:3, :3]
    softness, directions = np.linalg.eigh(C)
    is_soft = softness > 1e-12 * softness[-1]
    principal = [
        {
            "stiffness_N_per_um": 1e-6 / s if soft else None,
            "direction": (d * np.sign(d[np.argmax(np.abs(d))])).tolist(),
        }
        for s, d, soft in zip(softness, directions.T, is_soft, strict=True)
    ][::-1]
    along = np.diag(C)
    deflection = [
        1e3 * np.asarray(static_deflection(robot, q, _LOAD_N * np.eye(6)[i])[:3])
        for i in range(3)
    ]
    sag = np.asarray(gravity_sag(robot, q))
    return {
        "stiffness_along_axes_N_per_um": [
            1e-6 / s if s > 1e-12 * softness[-1] else None for s in along
        ],
        "principal_stiffness": principal,
        "load_N": _LOAD_N,
        "deflection_mm": [row.tolist() for row in deflection],
        "gravity_sag_mm": (1e3 * sag[:3]).tolist(),
        "gravity_tilt_mrad": (1e3 * sag[3:]).tolist(),
    }


def _modes(robot: "Robot", q: "JointPositions") -> list[dict[str, Any]]:
    """Return frequency, damping and shape of every mode that rings."""
    from ..robot import damped_modes

    found = damped_modes(robot, q)
    return [
        {
            "frequency_Hz": float(frequency),
            # Rounding may put what has no damper below 0.
            "damping_ratio": max(float(ratio), 0.0),
            "energy_shares": dict(zip(robot.joint_names, shares.tolist(), strict=True)),
            "tool_direction": _direction(shape[:3]),
        }
        for frequency, ratio, shares, shape in zip(
            found.frequencies,
            found.damping_ratios,
            found.energy_shares,
            found.tool_shapes,
            strict=True,
        )
    ]


def _direction(shape: "ComplexShape") -> list[float] | None:
    """Return the direction of the largest motion in a cycle, None without motion."""
    # Turned by this phase, the real part is the longer half axis of the ellipse.
    move = (shape * np.exp(-0.5j * np.angle(np.sum(shape**2)))).real
    size = float(np.linalg.norm(move))
    if not size > 0.0:
        return None
    # The greatest entry is positive.
    return (move / size * np.sign(move[np.argmax(np.abs(move))])).tolist()


def _filler(
    robot: "Robot", q: "JointPositions", facts: dict[str, Any]
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
        maps = [
            StiffnessMap.around(robot, q, plane=plane) for plane in ((0, 2), (0, 1))
        ]
        if not any(np.isfinite(item.stiffness).any() for item in maps):
            return
        title = f"{robot.name}: the tool keeps its direction; grey: not reached so"
        figure = plot_stiffness(robot, bones, maps, title=title)
        save_figure(figure, folder / "stiffness.png")

    return fill
