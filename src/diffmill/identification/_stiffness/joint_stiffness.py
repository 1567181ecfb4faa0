"""Joint stiffness from how far known loads move the tool.

The tool moves by d = sum_i c_i J_i (J_i^T w): linear in the compliances c_i = 1 / K_i,
each a number that cannot be negative. The share of gravity and load in the stiffness,
some per mille on an industrial arm, is left out as in `robot.cartesian_compliance`.

Friction of a joint holds back a part of its torque tau_i, and what yields behind the
joints, as a flange, moves the tool by c_f F. Where an F test sees a sign of them, the
flange alone or both are fitted beside the springs, with unknowns c_f and f_i:

    d = sum_i (c_i tau_i - f_i sign(tau_i)) J_i + c_f F,  tau_i = J_i^T w

What is left out puts the springs off, and an unknown too many only widens their
intervals: so a weak sign is enough.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...robot import Robot, jacobian
from .._statistics.grouped_nnls import Columns, GroupFit, Values, fit_groups
from .._statistics.robust_regression import correlation_of
from .axis_check import AxesCheck, Turns, better_axes

# Tables as users have them.
Table = Float[Array, "..."] | Float[np.ndarray, "..."] | Sequence[Sequence[float]]

# A compliance is rough if its standard error is above this share of it.
_ROUGH = 0.1
# Probabilities of the interval that is given, and of the one that must leave out a
# rigid joint: of many joints some seem soft by chance.
_GIVEN, _BOUNDED = 0.95, 0.99
# Probability of the bound on one side.
_ONE_SIDED = 0.95
# The springs must explain this share of the squared displacements.
_EXPLAINED = 0.7
# More wrong poses than this share of all say that the model or the table is wrong.
_OUTLIERS = 0.3
# A column smaller than this share of the largest is rounding.
_ROUNDING = 1e-9
# A flange that yields and friction are fitted if chance makes their part of the
# displacement as large in this share of tables at most, and there are so many numbers
# per unknown.
_BY_CHANCE, _NUMBERS = 0.2, 3


class JointStiffnessFit(eqx.Module):
    """Joint stiffness, how sure it is, and the joints that are not identifiable.

    Attributes:
        stiffness: K of each joint [N m/rad or N/m], shape (joint,); NaN for joints
            that are not identifiable.
        standard_errors: Of K, same unit and shape; NaN likewise.
        stiffness_bound: K is at least this, with 95 % confidence, shape (joint,); 0
            where nothing is known. Meaningful for joints without a number too.
        stiffness_interval: Least and largest K, with 95 % confidence, (joint, 2);
            0 and infinity for joints that are not identifiable.
        identifiable: Whether the loads bound the stiffness from both sides with
            99 % confidence, however widely, shape (joint,).
        compliance: c = 1 / K as fitted, never negative [rad/(N m) or m/N], shape
            (joint,); without meaning where not identifiable.
        compliance_errors: Standard errors of c, shape (joint,); infinite where the
            loads do not move the joint at all.
        correlation: Between the errors of c, shape (joint, joint); NaN where nothing
            is known.
        outliers: Rows of the table that contradict the others, ascending.
        explained: Share of the squared displacement that the springs explain, of the
            rows that agree; of all rows if too many do not.
        share: What each joint contributes to it, shape (joint,).
        is_consistent: Whether the table suits the robot: enough is explained, few
            rows contradict, and no other assignment of axes would suit much better.
        residual: Measured minus fitted displacement, shape (pose, component).
        offset: Constant displacement that was fitted too, in base axes, shape
            (component,), or None.
        has_flange: Whether a spring behind the joints was fitted too, since the table
            has a sign of it.
        has_friction: Whether their friction was, likewise, beside that spring.
        noise: "absolute" or "relative" (to the displacement), the likelier scatter.
        spread: Standard deviation of one displacement of median size [m]; infinite if
            there are no more numbers than unknowns.
        joint_names: Names in the order of the arrays.
        notes: What to know, in words.
    """

    stiffness: Float[np.ndarray, " joint"]
    standard_errors: Float[np.ndarray, " joint"]
    stiffness_bound: Float[np.ndarray, " joint"]
    stiffness_interval: Float[np.ndarray, "joint 2"]
    identifiable: Bool[np.ndarray, " joint"]
    compliance: Float[np.ndarray, " joint"]
    compliance_errors: Float[np.ndarray, " joint"]
    correlation: Float[np.ndarray, "joint joint"]
    outliers: tuple[int, ...] = eqx.field(static=True)
    explained: float
    share: Float[np.ndarray, " joint"]
    is_consistent: bool
    residual: Float[np.ndarray, "pose component"]
    offset: Float[np.ndarray, " component"] | None
    has_flange: bool
    has_friction: bool
    noise: str = eqx.field(static=True)
    spread: float
    joint_names: tuple[str, ...] = eqx.field(static=True)
    notes: tuple[str, ...] = eqx.field(static=True)

    @property
    def is_rough(self) -> Bool[np.ndarray, " joint"]:
        """True for joints known to no better than a tenth, or not at all."""
        rough = self.compliance_errors > _ROUGH * self.compliance
        return ~self.identifiable | rough


def fit_joint_stiffness(
    robot: Robot,
    q: Table,
    wrench: Table,
    displacement: Table,
    *,
    has_offset: bool = False,
    noise: str | None = None,
    load_frame: Turns | None = None,
    displacement_frame: Turns | None = None,
    max_relative_error: float = 1.0,
    min_explained: float = _EXPLAINED,
) -> JointStiffnessFit:
    """Fit the joints' stiffness to static load tests.

    Args:
        robot: The robot; only its kinematics count. Its tool is where the load acts
            and where the displacement is measured.
        q: Joint positions [rad or m], shape (pose, joint).
        wrench: Load on the tool at its origin in base axes, linear part first
            [N, N m], shape (pose, 6), or (pose, 3) for forces only.
        displacement: How far the load moves the tool's origin, in the axes of
            `displacement_frame`, linear part first [m, rad], shape (pose, 3) or
            (pose, 6); NaN for a component that was not measured.
        has_offset: Whether a displacement that is constant in base is fitted too, as
            of a tracker whose zero is not known.
        noise: "absolute" if all poses scatter alike, "relative" if in proportion to
            the displacement; the likelier of both if not given.
        load_frame: Rotations into base of the frame in which the load was recorded,
            shape (pose, 3, 3), None for base: the axes that would suit better are told
            in it.
        displacement_frame: Rotations into base of the axes of `displacement`, shape
            (pose, 3, 3), None for base.
        max_relative_error: A stiffness that is bounded is given if its relative
            standard error is at most this.
        min_explained: Below this share of the squared displacement the table is
            reported as not suiting the robot, and no stiffness is given.

    Returns:
        The fit; read `.notes`.

    Raises:
        ValueError: A table has a wrong shape or numbers that are not finite, or nothing
            moved.
    """
    angles, load, moved = load_tables(robot, q, wrench, displacement)
    if not np.nan_to_num(moved).any():
        raise ValueError(
            "Argument `displacement` must differ from zero in a row, but is zero."
        )
    # Rotations over their own size, as displacements are.
    scale = np.ones(moved.shape[1])
    if moved.shape[1] == 6:
        linear, angular = np.nanmedian(np.abs(moved).reshape(-1, 2, 3), axis=(0, 2))
        if linear > 0 and angular > 0:
            scale[3:] = linear / angular

    def columns_of(load: Float[np.ndarray, "pose 6"]) -> np.ndarray:
        columns = deflection_columns(robot, angles, load, displacement_frame)
        return columns[:, : moved.shape[1]] * scale[None, :, None]

    columns, moved = columns_of(load), moved * scale[None]
    constant = constant_columns(moved, displacement_frame)
    if not has_offset:
        constant = constant[:, :, :0]
    wide = np.concatenate([columns, constant], axis=2)
    is_free = np.arange(wide.shape[2]) >= robot.joint_count
    fit = fit_groups(wide, moved, is_free, noise=noise)
    yielding = _yielding_columns(robot, angles, load, displacement_frame)
    yielding = yielding[:, : moved.shape[1]] * scale[None, :, None]

    def explained(fit: GroupFit, constant: Columns, added: int) -> _Explained:
        # Where too many rows contradict, all of them count.
        used = ~fit.is_outlier | _contradicts(fit)
        centred = moved - constant @ fit.x[robot.joint_count :]
        square = float(np.nansum(centred[used] ** 2))
        left = float(np.nansum(fit.residual[used] ** 2))
        share = 1.0 - left / max(square, 1e-300)
        axes = better_axes(columns_of, load, centred, share, load_frame)
        return _Explained(
            columns[used], centred[used], share, min_explained, axes, added
        )

    table = explained(fit, constant, 0)
    # In wrong axes friction would explain what springs do not.
    if table.is_suited and not _contradicts(fit):
        fit, added = _with_yielding(fit, wide, is_free, yielding, moved)
        if added:
            constant = np.concatenate([constant, yielding[:, :, :added]], axis=2)
            table = explained(fit, constant, added)
    return _report(robot, table, fit, scale, max_relative_error)


class _Explained(NamedTuple):
    """Rows that count, with the share of them that springs explain.

    `added` is the number of unknowns beside the springs: 1 is the flange alone.
    """

    columns: Columns
    moved: Values
    share: float
    least: float
    axes: AxesCheck
    added: int

    @property
    def is_suited(self) -> bool:
        """True if enough is explained, and no other axes explain much more."""
        return self.share >= self.least and self.axes.better is None


def deflection_columns(
    robot: Robot,
    q: Float[np.ndarray, "pose joint"],
    wrench: Float[np.ndarray, "pose 6"],
    frame: Turns | None = None,
) -> Float[np.ndarray, "pose 6 joint"]:
    """Displacement of the tool under a load per unit compliance of each joint.

    Args:
        robot: The robot.
        q: Joint positions [rad or m], shape (pose, joint).
        wrench: Load on the tool in base axes [N, N m], shape (pose, 6).
        frame: Rotations into base of the axes of the result, shape (pose, 3, 3), None
            for base.

    Returns:
        J_i (J_i^T w), linear part first, shape (pose, 6, joint).
    """
    J = np.asarray(_jacobians(robot, jnp.asarray(q, robot.dtype)), np.float64)
    columns = J * np.einsum("pcj,pc->pj", J, wrench)[:, None]
    size = np.linalg.norm(columns, axis=(0, 1))
    # A force through a joint's axis turns it by rounding only.
    columns = np.where(size > _ROUNDING * size.max(initial=0.0), columns, 0.0)
    return _in_axes(columns, frame)


def _yielding_columns(
    robot: Robot,
    q: Float[np.ndarray, "pose joint"],
    wrench: Float[np.ndarray, "pose 6"],
    frame: Turns | None,
) -> Float[np.ndarray, "pose 6 unknown"]:
    """Displacement of the tool per flange that yields, and per friction of each joint.

    Args:
        robot: The robot.
        q: Joint positions [rad or m], shape (pose, joint).
        wrench: Load on the tool in base axes [N, N m], shape (pose, 6).
        frame: Rotations into base of the axes of the result, None for base.

    Returns:
        F, and -J_i sign(tau_i) of joints that the load turns, (pose, 6, 1 + joint).
    """
    J = np.asarray(_jacobians(robot, jnp.asarray(q, robot.dtype)), np.float64)
    torque = np.einsum("pcj,pc->pj", J, wrench)
    is_turned = np.abs(torque) > _ROUNDING * np.abs(torque).max(initial=0.0)
    friction = -J * (np.sign(torque) * is_turned)[:, None]
    force = np.pad(wrench[:, :3], ((0, 0), (0, 3)))
    return _in_axes(np.concatenate([force[..., None], friction], axis=2), frame)


def _with_yielding(
    fit: GroupFit,
    columns: Columns,
    is_free: Bool[np.ndarray, " unknown"],
    yielding: Float[np.ndarray, "group row yielding"],
    moved: Values,
) -> tuple[GroupFit, int]:
    """Fit with a flange that yields, or with friction too, if the table shows them.

    Of the two it is the one that chance explains less.

    Args:
        fit: The fit without.
        columns: Its columns, shape (pose, component, unknown).
        is_free: Which of its unknowns may be negative, shape (unknown,).
        yielding: Columns of the flange and of friction, likewise.
        moved: Displacements, shape (pose, component).

    Returns:
        The fit, and how many columns of `yielding` it has.
    """
    chances = {}
    for added in (1, yielding.shape[2]):
        wide = np.concatenate([columns, yielding[:, :, :added]], axis=2)
        chances[added] = _chance(fit, columns, wide, moved)
    added = min(chances, key=lambda count: chances[count])
    if chances[added] > _BY_CHANCE:
        return fit, 0
    wide = np.concatenate([columns, yielding[:, :, :added]], axis=2)
    is_free = np.append(is_free, np.ones(added, bool))
    return fit_groups(wide, moved, is_free, noise=fit.noise), added


def _chance(
    fit: GroupFit,
    columns: Columns,
    wide: Float[np.ndarray, "group row wider"],
    moved: Values,
) -> float:
    """Probability that chance lowers the misfit as much as more columns do [-].

    1 where they add nothing, or there are too few numbers for them.
    """
    from scipy.stats import f as f_distribution

    used = ~fit.is_outlier
    weight = fit.weights[used, None]
    known = np.isfinite(moved[used]).reshape(-1)
    right = (moved[used] * weight).reshape(-1)[known]

    def misfit(A: Float[np.ndarray, "group row any"]) -> tuple[float, int]:
        rows = (A[used] * weight[..., None]).reshape(-1, A.shape[2])[known]
        size = np.linalg.norm(rows, axis=0)
        rows = rows / np.where(size > 0, size, 1.0)
        x, _, rank, _ = np.linalg.lstsq(rows, right, rcond=_ROUNDING)
        return float(np.sum((right - rows @ x) ** 2)), int(rank)

    (before, few), (after, many) = misfit(columns), misfit(wide)
    freedom = len(right) - many
    if many == few or len(right) < _NUMBERS * wide.shape[2]:
        return 1.0
    exact = 1e-20 * float(np.sum(right**2))
    ratio = (before - after) / (many - few) / max(after / freedom, exact)
    return float(f_distribution.sf(ratio, many - few, freedom))


def constant_columns(moved: Values, frame: Turns | None) -> Columns:
    """Displacements in the axes of a frame per constant one in base.

    Args:
        moved: The displacements [m, rad], shape (pose, component).
        frame: Rotations of the axes into base, shape (pose, 3, 3), None for base.

    Returns:
        Shape (pose, component, component).
    """
    count, width = moved.shape
    return _in_axes(np.broadcast_to(np.eye(width)[None], (count, width, width)), frame)


def _in_axes(columns: Columns, frame: Turns | None) -> Columns:
    """Columns in base, linear part first, in the axes of a frame."""
    if frame is None:
        return columns
    parts = columns.reshape(len(columns), -1, 3, columns.shape[2])
    return np.einsum("pji,pkjn->pkin", frame, parts).reshape(columns.shape)


@eqx.filter_jit
def _jacobians(
    robot: Robot, q: Float[Array, "pose joint"]
) -> Float[Array, "pose 6 joint"]:
    return jax.vmap(lambda row: jacobian(robot, row))(q)


def load_tables(
    robot: Robot, q: Table, wrench: Table, displacement: Table
) -> tuple[
    Float[np.ndarray, "pose joint"],
    Float[np.ndarray, "pose 6"],
    Float[np.ndarray, "pose component"],
]:
    """Joint positions, loads with their moments, and displacements as arrays.

    Args:
        robot: The robot.
        q: Joint positions [rad or m], shape (pose, joint).
        wrench: Loads [N, N m], shape (pose, 6) or (pose, 3).
        displacement: [m, rad], shape (pose, 3) or (pose, 6).

    Raises:
        ValueError: A table has a wrong shape or numbers that are not finite.
    """
    angles, load, moved = (
        np.array(table, np.float64) for table in (q, wrench, displacement)
    )
    count = angles.shape[0] if angles.ndim == 2 else -1
    for name, table, widths in (
        ("q", angles, (robot.joint_count,)),
        ("wrench", load, (3, 6)),
        ("displacement", moved, (3, 6)),
    ):
        allowed = " or ".join(f"({max(count, 0)}, {width})" for width in widths)
        if table.ndim != 2 or table.shape[1] not in widths or len(table) != count:
            raise ValueError(
                f"Argument `{name}` must have shape {allowed}, one row per row of `q`, "
                f"but has shape {table.shape}."
            )
        if name != "displacement" and not np.all(np.isfinite(table)):
            row = int(np.argmin(np.isfinite(table).all(axis=1)))
            raise ValueError(
                f"Argument `{name}` must be finite, but row {row} is {table[row]}."
            )
    if np.any(np.isinf(moved)) or not np.any(np.isfinite(moved)):
        raise ValueError(
            "Argument `displacement` must have numbers, or NaN where nothing was "
            "measured, but has none or an infinite one."
        )
    load = np.pad(load, ((0, 0), (0, 6 - load.shape[1])))
    return angles, load, moved


def _contradicts(fit: GroupFit) -> bool:
    """True if too many rows contradict the others."""
    return bool(fit.is_outlier.mean() > _OUTLIERS)


def _report(
    robot: Robot,
    table: _Explained,
    fit: GroupFit,
    scale: Float[np.ndarray, " component"],
    max_relative_error: float,
) -> JointStiffnessFit:
    """Fit as stiffness, from the rows that count."""
    from scipy.special import stdtrit

    columns, moved, explained = table.columns, table.moved, table.share
    count = robot.joint_count
    c = fit.x[:count]
    errors = np.sqrt(np.diagonal(fit.covariance)[:count])
    offset = fit.x[count : len(fit.x) - table.added]
    offset = offset if offset.size else None
    too_many = _contradicts(fit)
    parts = np.nansum(columns * moved[..., None], axis=(0, 1))
    square = float(np.nansum(moved**2))
    is_consistent = table.is_suited and not too_many
    freedom = max(1, int(np.isfinite(moved).sum()) - len(fit.x))
    given, bounded = (stdtrit(freedom, 0.5 + 0.5 * p) for p in (_GIVEN, _BOUNDED))
    is_fixed = (
        is_consistent & (c > bounded * errors) & (errors <= max_relative_error * c)
    )
    safe = np.where(is_fixed, c, 1.0)
    bound = 1.0 / np.maximum(c + stdtrit(freedom, _ONE_SIDED) * errors, 1e-300)
    away = given * np.where(is_fixed, errors, 0.0)[:, None] * np.array([1.0, -1.0])
    interval = 1.0 / (safe[:, None] + away)
    return JointStiffnessFit(
        stiffness=np.where(is_fixed, 1.0 / safe, np.nan),
        standard_errors=np.where(is_fixed, errors / safe**2, np.nan),
        stiffness_bound=np.where(is_consistent, bound, 0.0),
        stiffness_interval=np.where(is_fixed[:, None], interval, [0.0, np.inf]),
        identifiable=is_fixed,
        compliance=c,
        compliance_errors=errors,
        correlation=correlation_of(fit.covariance)[:count, :count],
        outliers=tuple(int(i) for i in np.flatnonzero(fit.is_outlier)),
        explained=explained,
        share=parts * c / max(square, 1e-300),
        is_consistent=is_consistent,
        residual=fit.residual / scale[None],
        offset=None if offset is None else offset / scale,
        has_flange=table.added > 0,
        has_friction=table.added > 1,
        noise=fit.noise,
        spread=fit.spread,
        joint_names=robot.joint_names,
        notes=_notes(robot, table, fit, is_fixed),
    )


def _notes(
    robot: Robot,
    table: _Explained,
    fit: GroupFit,
    is_fixed: Bool[np.ndarray, " joint"],
) -> tuple[str, ...]:
    """Sentences about doubts and about joints that are not identifiable."""
    axes, explained, least = table.axes, table.share, table.least
    too_many = _contradicts(fit)
    notes = []
    if table.added:
        them = "a spring behind them was"
        if table.added > 1:
            them = "their friction and a spring behind them were"
        notes.append(
            f"Beside the springs of the joints, {them} fitted, since the table has a "
            "sign of it; intervals are wider by that."
        )
    if explained < least:
        notes.append(
            f"The joints' springs explain {max(explained, 0):.0%} of the squared "
            f"displacement, less than {least:.0%}: the table does not suit this robot "
            "(axes, units, signs, tool, or elasticity outside the joints). No "
            "stiffness is given."
        )
    if axes.better is not None:
        notes.append(
            f"With {axes.better} of what is x, y, z now the robot would explain much "
            "more: look at the axes of the table. They were not changed."
        )
    if not axes.is_possible:
        notes.append(
            "The axes could not be checked: too few rows have all components of the "
            "displacement."
        )
    if too_many:
        notes.append(
            f"{int(fit.is_outlier.sum())} of {len(fit.is_outlier)} rows contradict the "
            "others: too many to leave out."
        )
    elif fit.is_outlier.any():
        rows = ", ".join(str(i) for i in np.flatnonzero(fit.is_outlier))
        notes.append(f"Rows {rows} contradict the others and were left out.")
    lost = [n for n, ok in zip(robot.joint_names, is_fixed, strict=True) if not ok]
    if lost and explained >= least and axes.better is None and not too_many:
        notes.append(
            f"Not identifiable from these loads: {', '.join(lost)}; "
            "`suggest_load_tests` names poses that would show them."
        )
    return tuple(notes)
