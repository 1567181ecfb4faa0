"""How often inverse kinematics finds a pose or a line that is within reach.

Every pose is made by joint positions within the limits, every line is followed first
by small Newton steps that keep within them and away from singular poses: so both are
reachable. A failure is a pose that is not found, a false flag one that is found and
called not converged.
"""

import functools
import os
import pathlib
import warnings
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import diffmill.robot as dr
from reporting import Report

jax.config.update("jax_enable_x64", True)

POSES, LINES, ROWS = 400, 60, 100
# Length of a line as a share of the reach, and steps of its making per row.
LENGTH, FINE = 0.15, 2
# Nearer than that to the pose [m, rad] the tool is there.
THERE = 1e-7
# A line keeps that far from singular poses, in units of the arm's length.
CLEAR = 0.05
# What is solved, and where from.
STARTS = ("poses, home", "lines, home", "lines, near", "lines, start chosen")
# The frame that carries the tool, where it is not `tool0`.
TOOLS = {"erd_panda": "panda_hand_tcp"}
FOLDER = pathlib.Path(os.environ.get("DIFFMILL_REFERENCE_DATA", "../shared/data"))


class Outcome(NamedTuple):
    """Shares of poses: found, found but flagged, found beyond the limits."""

    failed: float
    flagged: float
    beyond: float


def measure(report: Report) -> None:
    """Print the shares of poses and lines that are found, for every arm."""
    report.say(f"{POSES} poses and up to {LINES} lines of {ROWS} rows for each arm")
    report.say("not found / found, but flagged / found beyond the limits [%]")
    report.say(f"{'arm':24}{'rotation':8}" + "".join(f"{s:>23}" for s in STARTS))
    totals: dict[str, list[Outcome]] = {}
    for robot in _robots():
        rng = np.random.default_rng(7)
        q = _random(robot, rng, POSES)
        Ts = np.asarray(jax.vmap(functools.partial(dr.forward_kinematics, robot))(q))
        starts, lines = _lines(robot, rng)
        home = np.broadcast_to(np.asarray(robot.home), starts.shape)
        near = starts + rng.uniform(-0.1, 0.1, starts.shape)
        for rotation in ("fixed", "free"):
            outcomes = [_poses(robot, Ts, rotation)]
            chosen = _chosen(robot, lines, rotation)
            outcomes += [
                _follow(robot, lines, s, rotation) for s in (home, near, chosen)
            ]
            cells = "".join(
                f"{100 * o.failed:9.2f} {100 * o.flagged:6.2f} {100 * o.beyond:6.2f}"
                for o in outcomes
            )
            report.say(f"{robot.name[:23]:24}{rotation:8}{cells}")
            for what, o in zip(
                ("poses", "home", "near", "chosen"), outcomes, strict=True
            ):
                totals.setdefault(f"{what} {rotation}", []).append(o)
    for what, found in totals.items():
        report.say(
            f"{what}: all arms: not found "
            f"{100 * np.nanmean([o.failed for o in found]):.2f} %, flagged "
            f"{100 * np.nanmean([o.flagged for o in found]):.2f} %, beyond "
            f"{100 * np.nanmean([o.beyond for o in found]):.2f} %"
        )


def _robots() -> list[dr.Robot]:
    """Return the built-in arms and those of the reference data."""
    robots = [dr.load(name) for name in dr.built_in_models()]
    for file in sorted((FOLDER / "robots" / "industrial").glob("*.urdf")):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", dr.RobotFileWarning)
            try:
                robots.append(dr.load(file, tool=TOOLS.get(file.stem, "tool0")))
            except dr.RobotFileError:
                robots.append(dr.load(file))
    return robots


def _random(robot: dr.Robot, rng: np.random.Generator, count: int) -> np.ndarray:
    lower, upper = np.asarray(robot.joint_lower), np.asarray(robot.joint_upper)
    motors = robot.motor_mask()
    lower, upper = np.where(motors, lower, 0.0), np.where(motors, upper, 0.0)
    lower, upper = np.maximum(lower, -np.pi), np.minimum(upper, np.pi)
    return rng.uniform(lower, upper, (count, len(lower)))


def _lines(robot: dr.Robot, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return where reachable lines start, and their poses."""
    q = _random(robot, rng, 4 * LINES)
    box = dr.StiffnessMap.reach_box(robot)
    length = LENGTH * np.max(box[1] - box[0]) / 2
    way = rng.normal(size=(len(q), 3))
    way *= length / np.linalg.norm(way, axis=1, keepdims=True)
    is_good = np.asarray(jax.vmap(functools.partial(_keeps_clear, robot))(q, way))  # pyright: ignore[reportArgumentType]
    q, way = q[is_good][:LINES], way[is_good][:LINES]
    Ts = np.asarray(jax.vmap(functools.partial(dr.forward_kinematics, robot))(q))
    Ts = np.repeat(Ts[:, None], ROWS, axis=1)
    Ts[:, :, :3, 3] += np.linspace(0, 1, ROWS)[None, :, None] * way[:, None]
    return q, Ts


def _keeps_clear(robot: dr.Robot, q: jax.Array, way: jax.Array) -> jax.Array:
    """Return whether Newton steps follow a line within limits, none of them large."""
    T = dr.forward_kinematics(robot, q)
    mask = jnp.asarray(robot.motor_mask())

    def step(q, share):
        error = jnp.zeros(6)
        for _ in range(3):
            now = dr.forward_kinematics(robot, q)
            turn = T[:3, :3] @ now[:3, :3].T
            error = jnp.concatenate(
                [
                    T[:3, 3] + share * way - now[:3, 3],
                    jnp.stack([turn[2, 1], turn[0, 2], turn[1, 0]])
                    - jnp.stack([turn[1, 2], turn[2, 0], turn[0, 1]]),
                ]
            ) / jnp.array([1.0, 1, 1, 2, 2, 2])
            J = jnp.where(mask, dr.jacobian(robot, q), 0.0)
            q = q + jnp.linalg.lstsq(J, error, rcond=1e-9)[0]
        is_clear = dr.singularity(robot, q).smallest > CLEAR
        within = jnp.all((q >= robot.joint_lower) & (q <= robot.joint_upper) | ~mask)
        return q, is_clear & within & (jnp.max(jnp.abs(error)) < THERE)

    shares = jnp.linspace(0, 1, FINE * ROWS)
    return jnp.all(jax.lax.scan(step, jnp.where(mask, q, 0.0), shares)[1])


def _poses(robot: dr.Robot, Ts: np.ndarray, rotation: dr.ToolRotation) -> Outcome:
    solve = lambda T: dr.inverse_kinematics(
        robot, T, robot.home, tool_rotation=rotation
    )
    return _outcome(jax.jit(jax.vmap(solve))(Ts))


def _chosen(
    robot: dr.Robot, lines: np.ndarray, rotation: dr.ToolRotation
) -> np.ndarray:
    """Return the starts that are chosen for lines, home where there is none."""
    rows = []
    for Ts in lines:
        found = dr.path_starts(robot, Ts, robot.home, tool_rotation=rotation)
        rows.append(found[0] if len(found) else np.asarray(robot.home))
    return np.array(rows).reshape(-1, robot.joint_count)


def _follow(
    robot: dr.Robot, lines: np.ndarray, starts: np.ndarray, rotation: dr.ToolRotation
) -> Outcome:
    """Return the shares of lines; one is found only where all its poses are."""
    if not len(lines):
        return Outcome(np.nan, np.nan, np.nan)
    solve = lambda Ts, q: dr.inverse_kinematics_path(
        robot, Ts, q, tool_rotation=rotation
    )
    return _outcome(jax.jit(jax.vmap(solve))(lines, starts))


def _outcome(found: dr.JointSolution) -> Outcome:
    away = np.maximum(found.position_residual, found.rotation_residual)
    along = tuple(range(1, away.ndim))
    is_there = np.all(away < THERE, axis=along)
    return Outcome(
        float(np.mean(~is_there)),
        float(np.mean(is_there & ~np.all(found.converged, axis=along))),
        float(np.mean(is_there & ~np.all(found.within_limits, axis=along))),
    )
