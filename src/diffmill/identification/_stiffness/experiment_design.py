"""Design of further load tests that would show a joint's stiffness."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...robot import Robot
from .._statistics.grouped_nnls import inverse_information
from .joint_stiffness import JointStiffnessFit, Table, deflection_columns, load_tables

# Poses that are looked at, each with forces along three directions.
_POSES = 200
# Half the range of joints without limits [rad].
_RANGE = np.pi
# A joint that turns the tool by less than this share of the softest one is not shown.
_SEEN = 1e-6
# Scatter over the displacement where a table has no numbers left to show it.
_SCATTER = 0.05


class LoadTests(eqx.Module):
    """Load tests to add to a table.

    Attributes:
        q: Joint positions [rad or m], shape (pose, joint).
        wrench: Forces in base axes, with zero moments [N, N m], shape (pose, 6).
        relative_errors: Standard error of each joint's compliance over the compliance
            itself that the table has with them, shape (joint,); infinite for joints
            that no force at the tool can turn, NaN for the others if the table does not
            show how it scatters.
        unobservable: Names of these joints: they need a tool with another offset, or a
            moment.
    """

    q: Float[np.ndarray, "pose joint"]
    wrench: Float[np.ndarray, "pose 6"]
    relative_errors: Float[np.ndarray, " joint"]
    unobservable: tuple[str, ...] = eqx.field(static=True)


def suggest_load_tests(
    robot: Robot,
    fit: JointStiffnessFit,
    q: Table,
    wrench: Table,
    *,
    count: int = 3,
) -> LoadTests:
    """Load tests that would fix the joints that a table knows badly.

    Random poses within the joints' limits, each with the largest force of the table
    along the axes of the base, are added one by one; each is the one that lowers the
    sum of squared relative errors of these joints most, if the next tests
    scatter like those of the table; by 5 % of the displacement if it has no more
    numbers than unknowns. No test is proposed twice: what a repetition averages out is
    scatter alone, not what is wrong with one pose. Joints without a number are taken to
    be as stiff as the robot model says. Collisions are not checked.

    Args:
        robot: The robot, with its stiffness as far as it is known.
        fit: The fit to the table.
        q: Joint positions of the table [rad or m], shape (pose, joint).
        wrench: Its loads [N, N m], shape (pose, 6) or (pose, 3).
        count: Number of tests to add.

    Returns:
        The tests.

    Raises:
        ValueError: A table has a wrong shape, the fit is not consistent, or more tests
            are asked for than there are candidates.
    """
    if count > 3 * _POSES:
        raise ValueError(
            f"Argument `count` must be at most {3 * _POSES}, the number of candidates, "
            f"but is {count}."
        )
    if not fit.is_consistent:
        raise ValueError(
            "Argument `fit` must be consistent before further poses can help, but is "
            f"not: {' '.join(fit.notes)}"
        )
    nowhere = np.zeros((len(fit.residual), 3))
    angles, load, _ = load_tables(robot, q, wrench, nowhere)
    model = 1.0 / np.asarray(robot.joint_stiffness, np.float64)
    c = np.where(fit.identifiable, fit.compliance, model)
    is_sought = fit.is_rough
    poses, forces = _candidates(robot, float(np.abs(load[:, :3]).max()))
    # In units of the expected compliances.
    seen = deflection_columns(robot, angles, load)[:, :3] * c
    offered = deflection_columns(robot, poses, forces)[:, :3] * c
    reach = np.linalg.norm(offered, axis=1).max(axis=0)
    is_lost = is_sought & ~(reach > _SEEN * reach.max())
    is_seen, is_known = ~is_lost, np.isfinite(fit.spread)
    usual = float(np.sqrt(np.mean(np.sum(seen, axis=2) ** 2)))
    spread = max(fit.spread if is_known else _SCATTER * usual, 1e-12)
    # Rows in units of their scatter.
    seen, offered = seen / spread, offered / spread
    chosen: list[int] = []
    rows = seen.reshape(-1, seen.shape[2])[:, is_seen]
    # A weak prior keeps what no row shows finite: 10 times the compliance expected.
    information = rows.T @ rows + 0.01 * np.eye(int(is_seen.sum()))
    parts = offered[:, :, is_seen]
    gains = np.einsum("pci,pcj->pij", parts, parts)
    for _ in range(count):
        inverse = np.linalg.inv(information[None] + gains)
        cost = np.einsum("pii,i->p", inverse, is_sought[is_seen].astype(float))
        cost[chosen] = np.inf
        chosen.append(int(np.argmin(cost)))
        information = information + gains[chosen[-1]]
    added = offered[chosen].reshape(-1, seen.shape[2])
    rows = np.vstack([seen.reshape(-1, seen.shape[2]), added])
    inverse, _ = inverse_information(rows)
    errors = np.sqrt(np.diagonal(inverse)) if is_known else np.full(len(c), np.nan)
    errors = np.where(is_lost, np.inf, errors)
    names = tuple(n for n, lost in zip(robot.joint_names, is_lost, strict=True) if lost)
    return LoadTests(poses[chosen], forces[chosen], errors, names)


def _candidates(
    robot: Robot, force: float
) -> tuple[Float[np.ndarray, "test joint"], Float[np.ndarray, "test 6"]]:
    """Random poses within the limits [rad or m], each with three forces [N, N m]."""
    lower, upper = (
        np.asarray(jnp.clip(limit, -_RANGE, _RANGE), np.float64)
        for limit in (robot.joint_lower, robot.joint_upper)
    )
    draw = np.random.default_rng(0)
    q = draw.uniform(lower, upper, (_POSES, robot.joint_count))
    load = np.zeros((_POSES, 3, 6))
    load[:, :, :3] = force * np.eye(3)[None]
    return np.repeat(q, 3, axis=0), load.reshape(-1, 6)
