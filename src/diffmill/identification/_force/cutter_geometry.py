"""Run-out and radius of the cutter from measured forces, by exact derivatives.

Unlike the coefficients they move the chip itself, so the cut is simulated anew in
every step of a Gauss-Newton iteration; the derivatives pass through the simulation.
Coefficients, time shifts and lengths take every step together, by the same robust fit
as the coefficients alone; a step that raises the cost is halved, and where none lowers
it the iteration ends. It takes the coarser simulation; one step of the finer one, from
there, ends it.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..._result import RESULTS, SimulationFailed
from ...cutter import AbstractCutter
from .._cut.cut_model import (
    Cut,
    CutForce,
    EngagementColumns,
    LinearForce,
    at_times,
    coarser,
    instantaneous_force,
    linear_force,
    with_plan,
)
from .._statistics.robust_regression import LinearFit, Loss, fit_rows
from .regression_rows import (
    RegisteredRecord,
    baseline_part,
    equations,
    shift_part,
    with_baselines,
)
from .tooth_alignment import LinearisedRecord, with_common_teeth

LENGTHS = ("runout", "radius")

# Run-out at which the fit starts at least [m]: at zero its direction has no derivative.
_START = 2e-6
# Longest step of a length [m], and the step at which the iteration ends: it converges
# quadratically, so that the next one would be far smaller.
_LONGEST_STEP, _SHORTEST_STEP = 1e-5, 1e-7
_STEPS, _HALVINGS = 15, 4
# A cost up to this many times that of before is not higher: sampled edges and stock
# make it uneven.
_ALIKE = 1.0001
# A length that the records do not show stays where it is: its column is below this
# share of the largest one.
_SHOWN = 1e-3


class CutterGeometry(eqx.Module):
    """Lengths of the cutter as fitted.

    Attributes:
        values: By name [m].
        records: The records with cuts by the fitted cutter.
        columns: Change of the force of each record per length [N/m], shape
            (row, 3, length), or None.
        has_converged: Whether the last step was small.
        has_moved: By name: whether the fit has left where it began; true where it may
            well end there, at a run-out that the cutter was given.
    """

    values: dict[str, float]
    records: list[RegisteredRecord]
    columns: list[np.ndarray | None]
    has_converged: bool
    has_moved: dict[str, bool]


def fit_cutter_geometry(
    records: list[RegisteredRecord],
    refine: tuple[str, ...],
    is_sought: bool,
    loss: Loss,
    shift_range: float | None = None,
) -> CutterGeometry:
    """Fit lengths of the cutter, with coefficients and time shifts.

    Args:
        records: The records, which share one cutter.
        refine: Which of `LENGTHS`.
        is_sought: Whether the time shifts are fitted too.
        loss: The loss.
        shift_range: Largest time shift either way [s]; any if None.

    Returns:
        The lengths, and the records for them.

    Raises:
        SimulationFailed: The cut could not be simulated.
    """
    names = (
        *(("runout_x", "runout_y") if "runout" in refine else ()),
        *(("radius",) if "radius" in refine else ()),
    )
    cutter = records[0].cut.cutter
    # The fit starts at the run-out that is given.
    size = max(float(np.max(np.asarray(cutter.runout))), _START)
    angle = float(np.asarray(cutter.runout_angle))
    lengths = {"runout_x": size * np.cos(angle), "runout_y": size * np.sin(angle)}
    start = x = np.array([lengths.get(name, 0.0) for name in names])
    is_runout_known = "runout" not in refine
    has_teeth = not is_runout_known or has_runout(cutter)
    K = fit_rows(with_baselines(records), loss).x[:6]
    state = [
        _simulated(dataclasses.replace(one, cut=coarser(one.cut)), names, x, K)
        for one in records
    ]
    has_converged = False
    for _ in range(_STEPS):
        if is_sought and has_teeth and len(state) > 1:
            state = with_common_teeth(
                state, K, shift_range, is_runout_known=is_runout_known
            )
        fit = _linear_fit(state, K, loss, is_sought)
        K = fit.x[:6]
        step, trial = _stepped(state, names, x, fit, is_sought)
        has_converged = bool(np.abs(step).max() < _SHORTEST_STEP)
        if trial is None:
            break
        x, state = x + step, trial
        if has_converged:
            break
    state = [
        _simulated(dataclasses.replace(one, shift=coarse.record.shift), names, x, K)
        for one, coarse in zip(records, state, strict=True)
    ]
    if has_converged:
        fit = _linear_fit(state, K, loss, is_sought)
        step, trial = _stepped(state, names, x, fit, is_sought)
        x, state = (x, state) if trial is None else (x + step, trial)
    columns = [one.columns() for one in state]
    return CutterGeometry(
        {n: float(v) for n, v in zip(names, x, strict=True)},
        [one.record for one in state],
        list(columns),
        has_converged,
        _have_moved(names, x - start, columns, has_runout(cutter) and has_converged),
    )


def _linear_fit(
    state: list[LinearisedRecord],
    K: np.ndarray,
    loss: Loss,
    is_sought: bool,
) -> LinearFit:
    """Fit of coefficients, lengths, offsets and time shifts in linear form."""
    records = [one.record for one in state]
    rows = [
        equations(
            one.record,
            (
                one.columns(),
                *baseline_part(records, i),
                *shift_part(records, i, K, is_sought),
            ),
        )
        for i, one in enumerate(state)
    ]
    return fit_rows(rows, loss)


def _have_moved(
    names: tuple[str, ...],
    moves: np.ndarray,
    columns: list[np.ndarray],
    is_stated_confirmed: bool,
) -> dict[str, bool]:
    """True for lengths that have left their start, or may well have ended there.

    Both parts of the run-out are one vector. A length that no record shows, or that is
    stated, may stay; the first one is not identifiable anyway.
    """
    is_runout = np.array([name.startswith("runout") for name in names])
    is_far = np.abs(moves) > _SHORTEST_STEP
    is_far = np.where(is_runout, np.any(is_far & is_runout), is_far)
    is_shown = np.any([np.any(one != 0, axis=(0, 1)) for one in columns], axis=0)
    may_stay = ~is_shown | ~is_runout | is_stated_confirmed
    return dict(zip(names, (is_far | may_stay).tolist(), strict=True))


def _stepped(
    state: list[LinearisedRecord],
    names: tuple[str, ...],
    x: np.ndarray,
    fit: LinearFit,
    is_sought: bool,
) -> tuple[np.ndarray, list[LinearisedRecord] | None]:
    """Step of a fit, halved until it does not raise the cost.

    Returns:
        The last step that was tried [m], shape (length,), and the records behind it;
        None if it raises the cost, as longer ones do.
    """
    count = len(names)
    step = fit.x[6 : 6 + count]
    step = step * min(1.0, _LONGEST_STEP / max(float(np.abs(step).max()), 1e-300))
    shifts = fit.x[-len(state) :] if is_sought else np.zeros(len(state))
    most = _ALIKE * _own_cost(state, fit)
    for share in 0.5 ** np.arange(_HALVINGS + 1):
        try:
            trial = [
                _simulated(
                    one.later(share * s).record, names, x + share * step, fit.x[:6]
                )
                for one, s in zip(state, shifts, strict=True)
            ]
        except SimulationFailed:
            # Lengths whose cut cannot be simulated are worse than any.
            continue
        if _own_cost(trial, fit) <= most:
            return share * step, trial
    return 0.5**_HALVINGS * step, None


def _own_cost(state: list[LinearisedRecord], fit: LinearFit) -> float:
    """Weighted square that coefficients alone leave, per weight.

    The lengths and shifts are those of the simulation, not of its linear form.
    """
    alone = fit_rows(with_baselines([one.record for one in state]), "huber")
    squares = [
        float(np.nansum(np.minimum(np.abs(r), 5 * s[None]) ** 2))
        for r, s in zip(alone.residual, fit.spread, strict=True)
    ]
    return sum(squares)


def has_runout(cutter: AbstractCutter) -> bool:
    """True if a cutter has a run-out of its own."""
    return bool(np.any(np.asarray(cutter.runout) > 0))


def _simulated(
    one: RegisteredRecord, names: tuple[str, ...], lengths: np.ndarray, K: np.ndarray
) -> LinearisedRecord:
    """Record with its cut for given lengths, linearised in these."""
    dtype = one.cut.stock.origin.dtype
    # The cutter with the radius that it was made with.
    diameter = jnp.asarray(2 * one.cut.cutter.nominal_radius, dtype)
    original = eqx.tree_at(lambda c: c.diameter, one.cut.cutter, diameter)
    if "runout_x" in names:
        # The plan of the cut is that of teeth which stand out.
        original = dataclasses.replace(original, has_runout=True)  # pyright: ignore[reportCallIssue]
    base = dataclasses.replace(one.cut, cutter=original)
    x = jnp.asarray(np.concatenate([K, lengths]), dtype)
    linear = _derivatives(with_plan(base), x, names)
    if linear.result != RESULTS.successful:
        raise SimulationFailed(RESULTS[linear.result])
    J = np.asarray(linear.slopes[1:], np.float64).reshape(-1, 3, len(x))
    F = np.asarray(linear.force[1:], np.float64).reshape(-1, 3)
    spacing = one.cut.tooth_period / linear.force.shape[1]
    constant = F - J[:, :, :6] @ K
    # A few micrometres of the cutter change little of its discretisation error.
    old, start = one.engagement, 0.5 * spacing
    instants = start + spacing * np.arange(len(constant))
    refinement = at_times(old.refinement, old.start, old.spacing, instants)
    engagement = EngagementColumns(start, spacing, J[:, :, :6], constant, refinement)
    cutter = cutter_with(base.cutter, names, jnp.asarray(lengths, dtype))
    moved = dataclasses.replace(
        one, cut=dataclasses.replace(one.cut, cutter=cutter), engagement=engagement
    )
    linearised = LinearisedRecord(moved, J[:, :, 6:])
    size = np.sqrt(np.mean(linearised.columns() ** 2, axis=(0, 1)))
    is_shown = size > _SHOWN * size.max(initial=0.0)
    return dataclasses.replace(linearised, slopes=np.where(is_shown, J[:, :, 6:], 0.0))


def cutter_with(
    cutter: AbstractCutter, names: tuple[str, ...], lengths: Array
) -> AbstractCutter:
    """Cutter with other run-out or radius.

    Args:
        cutter: The cutter.
        names: Of `runout_x`, `runout_y` and `radius`.
        lengths: Run-out towards tooth 0 and a quarter turn on, and growth of the
            radius [m], shape (name,).

    Returns:
        The cutter.

    Differentiability: smooth, but for a run-out of exactly zero.
    """
    changes: dict[str, Any] = {}
    if "runout_x" in names:
        x, y = lengths[names.index("runout_x")], lengths[names.index("runout_y")]
        changes = {
            "runout": jnp.hypot(x, y),
            "runout_angle": jnp.arctan2(y, x),
            "has_runout": True,
            "is_plain": False,
        }
    if "radius" in names:
        growth = lengths[names.index("radius")]
        changes["diameter"] = jnp.asarray(cutter.diameter) + 2 * growth
    return dataclasses.replace(cutter, **changes)  # pyright: ignore[reportArgumentType]


@eqx.filter_jit
def _derivatives(cut: Cut, x: Array, names: tuple[str, ...]) -> LinearForce:
    """Force with its derivatives by coefficients and lengths."""

    def run(x: Array) -> CutForce:
        cutter = cutter_with(cut.cutter, names, x[6:])
        return instantaneous_force(dataclasses.replace(cut, cutter=cutter), x[:6])

    return linear_force(run, x)
