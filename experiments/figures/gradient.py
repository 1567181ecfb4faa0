"""Gradients of the coupled simulation against differences, and both adjoints."""

import functools
import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

import diffmill as dm
from shared import LAW, TOOTH_PERIOD, Report, smooth_directions

ROWS = 200
SAMPLES = 80
SWEEP = (1e-7, 3e-8, 1e-8, 3e-9, 1e-9, 3e-10)
# Differences of single samples need a step that leaves rounding behind and that no
# kink of the neighbourhood comes into.
STEP = 1e-9
MILL = dm.cutter.flat_end_mill(10e-3, 2)
Scalar = Callable[[jax.Array], jax.Array]


def measure(report: Report) -> None:
    """Measure directions, single samples, rapid moves and the two adjoints."""
    path = jnp.asarray(path_with_corner())
    _machine()  # Built outside of what is traced.
    value = jax.jit(scalar(dm.process.ThroughPoses()))
    gradient = jax.jit(jax.grad(scalar(dm.process.ThroughPoses())))
    report.say()
    report.say(f"{ROWS} tooth periods, robot reis_rv130_like, cut with one corner;")
    report.say("scalar: sum of randomly weighted tip positions")
    slope = np.asarray(gradient(path))
    _directions(report, value, path, slope)
    _single_samples(report, value, path, slope)
    _rapid(report, gradient)
    _adjoints(report, path, slope)


def path_with_corner() -> np.ndarray:
    """Return a cut that starts and ends at rest, along x and then y, (step, 3)."""
    t = np.linspace(0, 1, ROWS)
    s = np.where(t < 0.1, 5 * t**2, np.where(t > 0.9, 0.9 - 5 * (1 - t) ** 2, t - 0.05))
    s = 32e-3 * s / s[-1]
    x = -5.6e-3 + np.minimum(s, 20e-3)
    y = 1.3e-3 + np.maximum(s - 20e-3, 0)
    return np.column_stack([x, y, np.full(ROWS, -1.03e-3)])


@functools.cache
def _machine() -> tuple[dm.robot.Robot, np.ndarray, dm.workpiece.Stock]:
    robot = dm.robot.load("reis_rv130_like")
    frame = np.eye(4)
    home = dm.robot.forward_kinematics(robot, robot.home)
    frame[:3, 3] = np.asarray(home)[:3, 3]
    stock = dm.workpiece.box([0, 0, -2.5e-3], [20e-3, 16e-3, 0], 0.2e-3)
    return robot, frame, stock


def actual(tips: jax.Array, adjoint: dm.process.AbstractAdjoint) -> jax.Array:
    """Return where the tip of the robot goes when it is commanded `tips` [m]."""
    robot, frame, stock = _machine()
    Ts = jnp.broadcast_to(jnp.asarray(frame)[None], (tips.shape[0], 4, 4))
    Ts = Ts.at[:, :3, 3].add(tips)
    q = dm.robot.inverse_kinematics_path(robot, Ts, robot.home).q
    motors = jax.vmap(lambda row: dm.robot.motor_positions(robot, row))(q)
    plan = dm.process.choose_engagement(stock, MILL, axial_depth=1.5e-3)
    speed = math.pi / TOOTH_PERIOD
    process = dm.process.Process(stock, MILL, LAW, speed, plan, derivative=adjoint)
    return dm.sim.ElasticArm(robot, frame).run(process, motors).actual


def scalar(adjoint: dm.process.AbstractAdjoint) -> Scalar:
    """Return the scalar that is differentiated, as a function of the path."""
    weights = jnp.asarray(np.random.default_rng(6).normal(size=(ROWS, 3)))
    return lambda tips: jnp.sum(weights * actual(tips, adjoint))


def _central(value: Scalar, path: jax.Array, direction: np.ndarray, h: float) -> float:
    ahead = float(value(path + h * direction))
    return (ahead - float(value(path - h * direction))) / (2 * h)


def _directions(
    report: Report, value: Scalar, path: jax.Array, slope: np.ndarray
) -> None:
    report.say()
    report.say("Central differences along smooth random directions: relative error")
    report.say("  step [m]  " + "".join(f"{h:>10.0e}" for h in SWEEP))
    best = []
    for index, direction in enumerate(
        smooth_directions(np.random.default_rng(5), ROWS, 5)
    ):
        wanted = float(np.sum(slope * direction))
        found = [abs(_central(value, path, direction, h) / wanted - 1) for h in SWEEP]
        report.say(f"  direction {index}" + "".join(f"{e:10.1e}" for e in found))
        best.append(found)
    # One step for all directions, so that none is chosen to fit.
    worst = np.max(best, axis=0)
    choice = int(np.argmin(worst))
    report.figure(
        f"largest error of the directions at {SWEEP[choice]:.0e} m",
        float(worst[choice]),
        1e-4,
        "",
    )


def _single_samples(
    report: Report, value: Scalar, path: jax.Array, slope: np.ndarray
) -> None:
    rng = np.random.default_rng(8)
    chosen = rng.choice(3 * ROWS, SAMPLES, replace=False)
    largest = np.abs(slope).max()
    center = float(value(path))
    kinks, unexplained = [], []
    for flat in chosen:
        unit = np.zeros(3 * ROWS)
        unit[flat] = 1.0
        unit = unit.reshape(ROWS, 3)
        wanted = float(slope.reshape(-1)[flat])
        error = abs(_central(value, path, unit, STEP) - wanted) / largest
        if error <= 1e-4:
            continue
        right, left = _one_sided(value, path, unit, center)
        is_kink = np.min(np.abs(right - left)) > 1e-4 * largest
        is_side = min(abs(right[-1] - wanted), abs(left[-1] - wanted)) < 1e-3 * largest
        (kinks if is_kink or is_side else unexplained).append(
            (flat, error, right, left)
        )
    report.say()
    report.say(
        f"Single samples: {SAMPLES} random ones of {3 * ROWS}, step {STEP:.0e} m"
    )
    share = 100 * (1 - (len(kinks) + len(unexplained)) / SAMPLES)
    report.at_least("samples within 1e-4 of the largest", share, 95.0, "%")
    for flat, error, right, left in [*kinks, *unexplained]:
        derivative = float(slope.reshape(-1)[flat])
        report.say(
            f"  row {flat // 3}, axis {'xyz'[flat % 3]}: off by {error:.1e} of the "
            f"largest; derivative {derivative:.6g}"
        )
        for h, a, b in zip(_ONE_SIDED, right, left, strict=True):
            report.say(f"    step {h:.0e} m: right {a:.6g}, left {b:.6g}")
    report.require("all others are kinks between or beside the steps", not unexplained)


_ONE_SIDED = (3e-9, 1e-9, 3e-10)


def _one_sided(
    value: Scalar, path: jax.Array, unit: np.ndarray, center: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return right and left differences at shrinking steps."""
    right = [(float(value(path + h * unit)) - center) / h for h in _ONE_SIDED]
    left = [(center - float(value(path - h * unit))) / h for h in _ONE_SIDED]
    return np.array(right), np.array(left)


def _rapid(report: Report, gradient: Callable) -> None:
    """Look for numbers that are not finite, with rapid moves of 3 mm a period."""
    path = path_with_corner()
    path[:30, 0] = path[30, 0] - 1e-3 - 3e-3 * np.arange(30)[::-1]
    path[100:110, 2] += np.minimum(np.arange(10), 4) * 1e-3
    path[110:, 2] += 4e-3
    path[120:150, 0] += 3e-3 * np.arange(30)
    path[150:, 0] += 3e-3 * 29
    report.say()
    found = np.asarray(gradient(jnp.asarray(path)))
    report.require(
        "finite with rapid moves in the path", bool(np.isfinite(found).all())
    )
    standing = path_with_corner()
    standing[60:90] = standing[60]
    found = np.asarray(gradient(jnp.asarray(standing)))
    report.require("finite with a dwell in the path", bool(np.isfinite(found).all()))


def _adjoints(report: Report, path: jax.Array, slope: np.ndarray) -> None:
    report.say()
    plain = np.asarray(jax.jit(jax.grad(scalar(dm.process.ThroughRays())))(path))
    difference = np.abs(plain - slope).max() / np.abs(slope).max()
    report.figure("reverse: Plain and Traced differ by", float(difference), 1e-9, "")
    direction = jnp.asarray(smooth_directions(np.random.default_rng(5), ROWS, 1)[0])
    tangents = []
    for adjoint in (dm.process.ThroughRays(), dm.process.ThroughPoses()):
        push = jax.jit(
            lambda p, d, a=adjoint: jax.jvp(lambda t: actual(t, a), (p,), (d,))[1]
        )
        tangents.append(np.asarray(push(path, direction)))
    scale = np.abs(tangents[1]).max()
    difference = np.abs(tangents[0] - tangents[1]).max() / scale
    report.figure("forward: Plain and Traced differ by", float(difference), 1e-9, "")
    weights = np.random.default_rng(6).normal(size=(ROWS, 3))
    along = float(np.sum(weights * tangents[1]))
    back = float(np.sum(slope * np.asarray(direction)))
    report.figure("forward and reverse differ by", abs(along / back - 1), 1e-9, "")
    report.require(
        "all finite", bool(math.isfinite(along) and np.isfinite(plain).all())
    )
