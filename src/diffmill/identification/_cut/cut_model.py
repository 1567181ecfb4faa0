"""Force of a cut per unit of every coefficient of the force law.

The force is linear in the six coefficients of `cutting.LinearEdgeLaw` once the path,
the stock and the cutter are given: F(t) = sum_i K_i C_i(t). One simulation with
derivatives by the coefficients gives all six columns C_i, for any path.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._job import Job
from ..._result import RESULTS, SimulationFailed
from ..._types import FloatRows3, RealScalarLike
from ...cutter import AbstractCutter
from ...cutting import AbstractForceLaw, LinearEdgeLaw
from ...process import (
    AbstractEngagement,
    EdgeElementsInSpace,
    Immersion,
    choose_engagement,
    default_element_height,
)
from ...sim import simulate_process
from ...workpiece import Stock

# Samples per revolution for paths of up to so many steps, and elements along the axis
# at most.
_ANGLES = {200: 480, 3000: 240, 10**9: 180}
_ELEMENTS = 16
# How many times coarser the second simulation is, by which the first is judged.
_COARSER = 2
# Samples per revolution by whose turn the default element may lag.
_DEFAULT_ANGLES = 180


class Cut(eqx.Module):
    """A cut whose forces were measured: all of a process but its force law.

    Attributes:
        positions: Tip in `work` at the tooth instants [m], shape (step, 3).
        stock: The workpiece before the cut.
        cutter: The cutter.
        spindle_speed: [rad/s].
        axes: Tool axes, shape (step, 3), or None for +z.
        engagement: How finely it is simulated, or None for the default.
        bottom_law: A known law of the bottom edges, or None for the one that follows
            from the coefficients.
    """

    positions: FloatRows3
    stock: Stock
    cutter: AbstractCutter
    spindle_speed: RealScalarLike
    axes: FloatRows3 | None = None
    engagement: AbstractEngagement | None = None
    bottom_law: AbstractForceLaw | None = None

    @property
    def tooth_period(self) -> float:
        """Time between two teeth [s]."""
        return 2 * math.pi / (float(self.spindle_speed) * self.cutter.flute_count)

    @property
    def duration(self) -> float:
        """Time from the first pose to the last [s]."""
        return self.tooth_period * (self.positions.shape[0] - 1)


class EngagementColumns(eqx.Module):
    """Force of a cut per unit coefficient, at evenly spaced instants.

    Attributes:
        start: First instant [s], from the first pose of the path.
        spacing: Time between two instants [s].
        columns: Force on the tool in `work` per coefficient, in the order of `NAMES`
            [m^2 or m], shape (sample, 3, 6).
        constant: Force that does not depend on them [N], shape (sample, 3).
        refinement: What half as many angles and rays change of the columns, a measure
            of their discretisation error; shape (sample, 3, 6).
    """

    start: float
    spacing: float
    columns: Float[np.ndarray, "sample 3 6"]
    constant: Float[np.ndarray, "sample 3"]
    refinement: Float[np.ndarray, "sample 3 6"]

    @classmethod
    def of_cut(cls, process_or_job: Cut | Job) -> "EngagementColumns":
        """Force of a cut per unit of every coefficient, by two simulations.

        Args:
            process_or_job: The cut, or a job, of which the desired path is cut.

        Returns:
            The columns, at the angle samples of the finer simulation.

        Raises:
            SimulationFailed: The simulation ran out of intervals or of its window.

        **Differentiability**: runs on the host; `instantaneous_force` is what it
        differentiates.
        """
        cut = cut_of(process_or_job)
        fine, coarse = _sampled(cut), _sampled(coarser(cut))
        time = fine.start + fine.spacing * np.arange(len(fine.columns))
        before = at_times(coarse.columns, coarse.start, coarse.spacing, time)
        return cls(*fine, refinement=fine.columns - before)


class _Sampled(NamedTuple):
    """Force of one simulation of a cut, as `EngagementColumns`."""

    start: float
    spacing: float
    columns: Float[np.ndarray, "sample 3 6"]
    constant: Float[np.ndarray, "sample 3"]


def _sampled(cut: Cut) -> _Sampled:
    """Force of a cut by one simulation."""
    linear = _columns(cut)
    if linear.result != RESULTS.successful:
        raise SimulationFailed(RESULTS[linear.result])
    spacing = cut.tooth_period / linear.slopes.shape[1]
    # Row k holds the period that ends at instant k.
    columns = np.asarray(linear.slopes[1:], np.float64).reshape(-1, 3, 6)
    constant = np.asarray(linear.force[1:], np.float64).reshape(-1, 3)
    return _Sampled(0.5 * spacing, spacing, columns, constant)


def coarser(cut: Cut) -> Cut:
    """Cut with half as many rays and angles.

    Args:
        cut: The cut, with a plan.
    """
    stock, plan = cut.stock, cut.engagement
    assert plan is not None
    step = _COARSER
    families = jax.tree.map(lambda x: x[::step, ::step], stock.families)
    stock = dataclasses.replace(stock, families=families, spacing=step * stock.spacing)
    coarse = dataclasses.replace(cut, stock=stock, engagement=None)
    return with_plan(coarse, angles=plan.angles // step)


def cut_of(process_or_job: Cut | Job) -> Cut:
    """Cut of a job, along its desired path by a rigid machine.

    Args:
        process_or_job: A job, or a cut, which is returned with its plan filled in.

    Returns:
        The cut.

    Raises:
        ValueError: It is neither.
    """
    if isinstance(process_or_job, Job):
        job = process_or_job.with_precision()
        cut = Cut(
            job.path.positions,
            job.stock,
            job.cutter,
            job.spindle_speed,
            jnp.asarray(job.path.axes) if job.simulation.axes else None,
            bottom_law=job.bottom_law,
        )
        return with_plan(cut)
    if not isinstance(process_or_job, Cut):
        raise ValueError(
            "Argument `process_or_job` must be a job or an `identification.Cut` (what "
            "`simulate_process` returns does not say how each coefficient acts), but "
            f"is a {type(process_or_job).__name__}."
        )
    cut = process_or_job
    return cut if cut.engagement is not None else with_plan(cut)


def with_plan(
    cut: Cut, cutter: AbstractCutter | None = None, angles: int | None = None
) -> Cut:
    """Cut with sizes that suit identification, for its cutter or another.

    Finer than for a prediction of mean forces: the waveform counts, and an element of a
    helical edge lags by no more than one sample. All teeth are looked at all the time:
    where two change places, the edge forces of both matter to the waveform.

    Args:
        cut: The cut.
        cutter: The cutter to put in its place, if any.
        angles: Samples per revolution; by the length of the path if not given, and
            those of its plan if it has one.

    Returns:
        The cut with a plan.
    """
    cutter = cut.cutter if cutter is None else cutter
    # Plain cutters take a quicker program, which looks at some teeth only.
    cutter = dataclasses.replace(cutter, is_plain=False)  # pyright: ignore[reportCallIssue]
    axes = None if cut.axes is None else np.asarray(cut.axes, np.float64)
    if axes is not None and np.allclose(axes, [0.0, 0.0, 1.0], atol=1e-9):
        axes = None
    old = cut.engagement
    usual = next(n for steps, n in _ANGLES.items() if len(cut.positions) <= steps)
    usual = usual if angles is None else angles
    angles = usual if old is None else old.angles
    depth, plunges = Immersion.of_path(cut.positions, cut.stock, cutter)
    height = default_element_height("near_far", cut.stock.spacing, cutter)
    height = max(height * _DEFAULT_ANGLES / usual, depth / _ELEMENTS)
    height = height if old is None else old.discs.height
    engagement = choose_engagement(
        cut.stock,
        cutter,
        axial_depth=depth,
        angles=angles,
        substeps=8 if old is None else old.substeps,
        element_height=height,
        axes=axes,
        is_upright=axes is None,
        plunges=plunges,
        has_bottom=plunges or axes is not None,
    )
    assert isinstance(engagement, EdgeElementsInSpace)
    profile = dataclasses.replace(engagement.profile, keeps_all=True)
    engagement = dataclasses.replace(engagement, profile=profile)
    axes = None if axes is None else cut.axes
    return dataclasses.replace(cut, cutter=cutter, axes=axes, engagement=engagement)


class CutForce(eqx.Module):
    """Force on the tool in `work` at every angle sample.

    Attributes:
        force: [N], shape (step, sample, 3), row 0 zero.
        result: Outcome of the simulation.
    """

    force: Float[Array, "step sample 3"]
    result: RESULTS


class LinearForce(eqx.Module):
    """Force at a point and its derivatives.

    Attributes:
        slopes: Derivatives of the force, shape (step, sample, 3, unknown).
        force: [N], shape (step, sample, 3).
        result: Outcome of the simulation.
    """

    slopes: Float[Array, "step sample 3 unknown"]
    force: Float[Array, "step sample 3"]
    result: RESULTS


def linear_force(
    run: Callable[[Float[Array, " unknown"]], CutForce], x: Float[Array, " unknown"]
) -> LinearForce:
    """Force of a cut at some unknowns, with its derivatives by them."""

    def with_outcome(x: Float[Array, " unknown"]):
        outcome = run(x)
        return outcome.force, outcome

    slopes, outcome = jax.jacfwd(with_outcome, has_aux=True)(x)
    return LinearForce(slopes, outcome.force, outcome.result)


def instantaneous_force(cut: Cut, coefficients: Float[Array, " 6"]) -> CutForce:
    """Force at every angle sample.

    Args:
        cut: The cut, with a plan.
        coefficients: K in the order of `NAMES` [Pa, N/m], shape (6,).

    Differentiability: as `sim.simulate_process`.
    """
    solution = simulate_process(
        cut.positions,
        cut.stock,
        cut.cutter,
        LinearEdgeLaw(*coefficients),
        cut.spindle_speed,
        cut.axes,
        engagement=cut.engagement,
        bottom_law=cut.bottom_law,
        keeps_instantaneous=True,
    )
    assert solution.instantaneous_force is not None
    return CutForce(solution.instantaneous_force, solution.result)


@eqx.filter_jit
def _columns(cut: Cut) -> LinearForce:
    """Derivatives by the coefficients, and the force without them."""
    none = jnp.zeros(6, cut.stock.origin.dtype)
    return linear_force(lambda k: instantaneous_force(cut, k), none)


def at_times(
    values: Float[np.ndarray, "..."],
    start: float,
    spacing: float,
    time: np.ndarray,
) -> Float[np.ndarray, "..."]:
    """Evenly spaced values at other instants, straight lines between them.

    Args:
        values: Values at start + i spacing, shape (sample, ...).
        start: First instant [s].
        spacing: Time between two [s].
        time: Instants [s], shape (row,); outside, the nearest value is taken.

    Returns:
        Values, shape (row, ...).
    """
    place = np.clip((time - start) / spacing, 0.0, len(values) - 1)
    first = np.minimum(place.astype(np.int64), len(values) - 2)
    share = (place - first).reshape(-1, *[1] * (values.ndim - 1))
    # In place: records have millions of rows.
    result, rise = values[first], values[first + 1]
    rise -= result
    rise *= share
    result += rise
    return result
