"""Joint stiffness from synthetic load tests with noise and gross errors."""

import jax
import jax.numpy as jnp
import numpy as np

from diffmill import identification, robot as rb

SEEDS = 20


def _arm():
    """Return an arm whose tool is at the centre of its wrist: no force turns that."""
    robot = rb.load("kuka_kr210_like")
    T = np.eye(4)
    robot = robot.with_tool(jnp.asarray(T))
    T[2, 3] = -np.linalg.norm(np.asarray(rb.jacobian(robot, robot.home))[:3, 4])
    return robot.with_tool(jnp.asarray(T))


def measure(report):
    robot = _arm()
    K = np.asarray(robot.joint_stiffness)
    worst, named, lost, explained = 0.0, 0, 0, 0.0
    for seed in range(SEEDS):
        draw = np.random.default_rng(seed)
        q = np.asarray(robot.home)[None] + draw.uniform(-0.7, 0.7, (20, 6))
        force = draw.normal(size=(20, 3)) * 500
        C = np.asarray(jax.vmap(lambda q: rb.cartesian_compliance(robot, q))(q))
        moved = np.einsum("pij,pj->pi", C[:, :3, :3], force)
        moved *= 1 + 0.05 * draw.normal(size=moved.shape)
        bad = sorted(draw.choice(20, 2, replace=False).tolist())
        moved[bad[0]] *= -1
        moved[bad[1]] *= 3
        fit = identification.fit_joint_stiffness(robot, q, force, moved)
        named += fit.outliers == tuple(bad)
        lost += fit.identifiable.tolist() == [True] * 3 + [False] * 3
        worst = max(worst, 100 * np.abs(fit.stiffness[:3] / K[:3] - 1).max())
        turned = identification.fit_joint_stiffness(
            robot, q, force, moved[:, [1, 2, 0]]
        )
        explained = max(explained, turned.explained)
    report.say(f"20 poses, 5 % noise, 2 gross errors, wrist at rest, {SEEDS} tables")
    report.figure("largest error of joints 1 to 3", worst, 5)
    report.at_least(
        "tables whose gross errors are named", 100 * named / SEEDS, 100, "%"
    )
    report.at_least("tables whose wrist is left open", 100 * lost / SEEDS, 100, "%")
    report.figure("explained with permuted axes, largest", 100 * explained, 70)
