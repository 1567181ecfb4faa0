"""Long runs in segments of one length: programs and devices hold one at a time.

The rows of a segment are taken to the host before the next one runs, which goes on
from its state. What goes from segment to segment on the device is that state alone: the
stock, the poses that wait for removal and those that it looks back on.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PyTree

from ..._arrays import is_traced, on_device
from ..._padding import LONGEST, whole_parts
from ...numerics import CachedJit
from ...process import Process
from ...toolpath import Path
from ...workpiece import Rays
from .._machine.adaptive_updates import run_adaptive
from .._machine.machine import (
    AbstractMachine,
    Removal,
    RunEnd,
    RunSegment,
    RunState,
    TurnChips,
    outcome,
)
from .checkpoint import RunCheckpoint, RunPlace, SegmentOutputs
from .path_segments import PathSegment, Segments

# From slots of a ray along x, y and z that are too few to more; None for no more.
MoreSlots: TypeAlias = Callable[[Sequence[int]], Sequence[int] | None]


class SegmentedRun(NamedTuple):
    """Outcome of a run in segments, beside its rows.

    Attributes:
        initial_overlap_volume: As of `Run`.
        removal: As of `Run`.
        chips: As of `Run`.
    """

    initial_overlap_volume: Float[Array, ""]
    removal: Removal
    chips: TurnChips | None


class PathRows(NamedTuple):
    """Rows of a run on the host, filled segment by segment.

    Attributes:
        command: Returns what the machine is told in a segment, as for `run_segment`,
            and the state of whoever tells it; called with that behind the segment
            before, which is None at first.
        path: Arrays of the whole path, a tree.
        of_segment: Returns their rows in a segment, from what the machine was told and
            the segment's run.
    """

    command: Callable[[PathSegment, PyTree], tuple[PyTree, PyTree]]
    path: PyTree
    of_segment: Callable[[PyTree, RunSegment], PyTree]


class SegmentPlan(NamedTuple):
    """Plan of a run in segments, for a path that is long.

    Attributes:
        periods: Tooth periods of a segment, in whole parts of `scan_rows`; a path of at
            most so many rows is run whole.
        on_rows: Called after each segment with the number of rows done.
        more_slots: Returns the slots with which a segment is run again in which a ray
            ran out of them.
        checkpoint: Where finished segments are kept.
        is_adaptive: Whether several tooth periods share an engagement update where
            the cut is steady: a short path is then a segment, too.
    """

    periods: int = LONGEST
    on_rows: Callable[[int], None] = lambda count: None
    more_slots: MoreSlots = lambda counts: None
    checkpoint: RunCheckpoint = RunCheckpoint()
    is_adaptive: bool = False

    def suits(self, path: Path, given: object) -> bool:
        """True if a path is run in segments: a long one, of which nothing is traced.

        One of which something is traced is run whole, with an update in each period.

        Args:
            path: The path.
            given: All that its run depends on.
        """
        is_padded = path.row_count is not None
        is_long = self.is_adaptive or path.step_count > self.periods
        return is_long and not (is_padded or is_traced(given))

    def segments(self, row_count: int) -> Segments:
        """Segments of a path of so many rows."""
        return Segments(row_count, whole_parts(self.periods) + 1)


def run_in_segments(
    machine: AbstractMachine,
    process: Process,
    segments: Segments,
    rows: PathRows,
    plan: SegmentPlan,
) -> SegmentedRun:
    """Run a machine segment by segment, from behind those that a checkpoint has.

    Args:
        machine: The machine.
        process: The process.
        segments: The segments of the path.
        rows: The rows of the path, which are filled.
        plan: How the run is done.

    Returns:
        The end of the run.

    **Differentiability**: runs on the host.
    """
    total, dtype = segments.total, np.dtype(process.stock.origin.dtype)
    volume, by_shank = np.zeros((2, total), dtype)
    has_failed, is_finite, overlap = np.zeros(total, bool), True, 0.0
    like = SegmentOutputs.like(rows.path)
    place = None
    for segment in segments:
        outputs = plan.checkpoint.outputs(segment, like)
        if outputs is None:
            place = place or _place(machine, process, segments, rows, plan)
            place, outputs = _ran(machine, process, segment, place, rows, plan)
            plan.checkpoint.put(segment, outputs, place)
        removed = jax.tree.map(np.asarray, outputs.removed)
        if segment.first == 0:
            # The first period removes nothing but what the tool stood in.
            overlap = removed.volume[0].sum(dtype=dtype)
            removed = jax.tree.map(lambda x: x[1:], removed)
        _add_volumes(volume, segment.first, removed.pose, removed.volume)
        _add_volumes(by_shank, segment.first, removed.pose, removed.by_shank)
        own = slice(segment.first + 1, segment.first + segment.row_count)
        has_failed[own] = outputs.has_failed[: segment.row_count - 1]
        is_finite &= bool(outputs.is_finite)
        segment.put(rows.path, outputs.rows)
        plan.on_rows(segment.first + segment.row_count)
    place = place or _place(machine, process, segments, rows, plan)
    last = total - 1
    process = _with_stock_of(process, place.state)
    end = _finished(machine, process, place.state, place.standing_count)
    removed = jax.device_get(end.removed)
    _add_volumes(volume, last, removed.pose, removed.volume)
    _add_volumes(by_shank, last, removed.pose, removed.by_shank)
    has_failed[last] |= bool(end.has_failed)
    removal = Removal(
        removed_volume=on_device(volume),
        shank_volume=on_device(by_shank),
        stock=end.stock,
        has_failed=on_device(has_failed),
        result=outcome(end, jnp.asarray(is_finite)),
    )
    overlap = on_device(np.asarray(overlap, dtype))
    return SegmentedRun(overlap, removal, machine.chips(place.state.machine))


def _place(
    machine: AbstractMachine,
    process: Process,
    segments: Segments,
    rows: PathRows,
    plan: SegmentPlan,
) -> RunPlace:
    """Place at which a run begins, or at which a checkpoint goes on."""
    told, teller = rows.command(next(iter(segments)), None)
    state, none = _begun(machine, process, told), on_device(np.zeros((), np.int32))
    begun = RunPlace(state, None, none)
    place = plan.checkpoint.place(RunPlace(state, teller, none))
    if place is None:
        return begun
    counts, wanted = (
        x.interval_counts for x in (process.stock, place.state.process.stock)
    )
    while counts is not None and counts != wanted:
        # The run until there has asked for more.
        counts = plan.more_slots(counts)
    return place


def _ran(
    machine: AbstractMachine,
    process: Process,
    segment: PathSegment,
    place: RunPlace,
    rows: PathRows,
    plan: SegmentPlan,
) -> tuple[RunPlace, SegmentOutputs]:
    """Place of a run behind a segment, and its outputs in it."""
    told, teller = rows.command(segment, place.teller)
    count, state = on_device(np.asarray(segment.row_count, np.int32)), place.state
    while True:
        own = _with_stock_of(process, state)
        ran = _segment(machine, own, told, state, count, plan.is_adaptive)
        if not bool(ran.state.process.has_overflow):
            break
        counts = plan.more_slots(state.process.stock.interval_counts)
        if counts is None:
            break
        state = _widened(state, counts)
        # No segment has as few slots again.
        _segment.forget()
    counted = [np.asarray(x)[: segment.row_count] for x in (ran.actual, ran.force)]
    outputs = SegmentOutputs(
        rows=rows.of_segment(told, ran),
        removed=ran.removed,
        has_failed=ran.has_failed,
        is_finite=np.asarray(all(np.isfinite(x).all() for x in counted)),
    )
    place = RunPlace(ran.state, teller, ran.standing_count)
    return place, jax.device_get(outputs)


def _with_stock_of(process: Process, state: RunState) -> Process:
    """Process with the stock of a state: its own would be carried along beside it."""
    return eqx.tree_at(lambda p: p.stock, process, state.process.stock)


def _widened(state: RunState, counts: Sequence[int]) -> RunState:
    """State at the start of a segment with more slots, empty ones behind its own."""
    families, cut_by = [], []
    assert state.cut_by is not None
    pairs = zip(state.process.stock.families, state.cut_by, counts, strict=True)
    for rays, ticks, count in pairs:
        more = (*rays.ends.shape[:3], count - rays.ends.shape[3])
        dead = jnp.asarray([Rays.DEAD, -Rays.DEAD], rays.ends.dtype)[:, None]
        ends = jnp.concatenate([rays.ends, jnp.broadcast_to(dead, more)], axis=3)
        # What no pose has cut remembers its slot.
        raw = -1 - jnp.arange(rays.ends.shape[3], count, dtype=ticks.dtype)
        ticks = jnp.concatenate([ticks, jnp.broadcast_to(raw, more)], axis=3)
        families.append(Rays(ends, ticks).numbered())
        cut_by.append(ticks)
    stock = lambda s: (s.process.stock.families, s.cut_by)
    return eqx.tree_at(stock, state, (tuple(families), tuple(cut_by)))


def _add_volumes(
    path: Float[np.ndarray, " step"],
    first: int,
    pose: Int[np.ndarray, "*some"],
    volume: Float[np.ndarray, "*some"],
) -> None:
    """Add volumes removed at some poses, which are counted from a row of the path."""
    # Periods that were left out name poses that are none.
    is_removed = volume != 0
    np.add.at(path, first + pose[is_removed], volume[is_removed])


@CachedJit
def _begun(machine: AbstractMachine, process: Process, command: PyTree) -> RunState:
    state = machine.begin_run(process, command)
    cut_by = tuple(rays.poses for rays in state.process.stock.families)
    return dataclasses.replace(state, cut_by=cut_by)


@CachedJit
def _segment(
    machine: AbstractMachine,
    process: Process,
    command: PyTree,
    state: RunState,
    row_count: Int[Array, ""],
    is_adaptive: bool,
) -> RunSegment:
    adaptive = run_adaptive if is_adaptive else None
    return machine.run_segment(process, command, state, row_count, adaptive=adaptive)


@CachedJit
def _finished(
    machine: AbstractMachine,
    process: Process,
    state: RunState,
    standing_count: Int[Array, ""],
) -> RunEnd:
    return machine.finish_run(process, state, standing_count)
