"""Long runs in segments of one length: programs and devices hold one at a time.

The rows of a segment are taken to the host before the next one runs, which goes on
from its state: the stock, the poses that wait for removal and those that it looks back
on. Of the stock, a segment gets the pieces of rays within the tool's reach; the others
wait on the host. So a ray that crosses a long part has few pieces at once, however many
it has in all.
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
from ..._types import FloatRows3
from ...numerics import CachedJit
from ...process import Process
from ...toolpath import Path
from ...workpiece import StockPieces
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
        tips: Tips that the machine is to reach [m], shape (step, 3).
    """

    command: Callable[[PathSegment, PyTree], tuple[PyTree, PyTree]]
    path: PyTree
    of_segment: Callable[[PyTree, RunSegment], PyTree]
    tips: FloatRows3


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
    pieces = StockPieces.of(end.stock).joined(place.apart)
    counts = map(max, pieces.most_on_a_ray(), process.stock.interval_counts)
    removal = Removal(
        removed_volume=on_device(volume),
        shank_volume=on_device(by_shank),
        stock=pieces.stock(end.stock, tuple(counts)),
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
    apart = StockPieces.none(process.stock)
    begun = RunPlace(state, None, none, apart)
    place = plan.checkpoint.place(RunPlace(state, teller, none, apart))
    if place is None:
        return begun
    wanted = place.state.process.stock.interval_counts
    # The run until there has asked for more.
    _enough(wanted, process.stock.interval_counts, plan)
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
    count = on_device(np.asarray(segment.row_count, np.int32))
    counts, pieces = place.state.process.stock.interval_counts, _pieces(place)
    tips = np.asarray(rows.tips)[segment.rows()]
    # The tool leaves its path by less than its radius, or the segment runs again.
    room = float(process.cutter.nominal_radius)
    while True:
        least, most = tips.min(axis=0) - room, tips.max(axis=0) + room
        near, apart = _parted(process, place.state, pieces, least, most)
        counts = _enough(near.most_on_a_ray(), counts, plan)
        state = _with_pieces(place.state, near, counts)
        own = _with_stock_of(process, state)
        ran = _segment(machine, own, told, state, count, plan.is_adaptive)
        counted = [np.asarray(x)[: segment.row_count] for x in (ran.actual, ran.force)]
        has_left = np.any((counted[0] < least) | (counted[0] > most))
        if has_left and any(apart.most_on_a_ray()):
            room *= 2
            continue
        if not bool(ran.state.process.has_overflow):
            break
        more = _more(counts, plan)
        if more is None:
            break
        counts = more
    outputs = SegmentOutputs(
        rows=rows.of_segment(told, ran),
        removed=ran.removed,
        has_failed=ran.has_failed,
        is_finite=np.asarray(all(np.isfinite(x).all() for x in counted)),
    )
    place = RunPlace(ran.state, teller, ran.standing_count, apart)
    return place, jax.device_get(outputs)


def _enough(
    needed: Sequence[int], counts: Sequence[int], plan: SegmentPlan
) -> Sequence[int]:
    """Slots of a ray along each axis with room for so many pieces."""
    while any(n > count for n, count in zip(needed, counts, strict=True)):
        # Where no more may be asked for, what is there must have room.
        counts = _more(counts, plan) or tuple(map(max, needed, counts))
    return counts


def _more(counts: Sequence[int], plan: SegmentPlan) -> Sequence[int] | None:
    """More slots, or None; no segment has as few again."""
    _segment.forget()
    return plan.more_slots(counts)


def _pieces(place: RunPlace) -> StockPieces:
    """Pieces of the whole stock, with the ticks of the whole run."""
    state = place.state
    assert state.cut_by is not None
    poses = lambda stock: [rays.poses for rays in stock.families]
    stock = eqx.tree_at(poses, state.process.stock, list(state.cut_by))
    return StockPieces.of(stock).joined(place.apart)


def _parted(
    process: Process,
    state: RunState,
    pieces: StockPieces,
    least: Float[np.ndarray, " 3"],
    most: Float[np.ndarray, " 3"],
) -> tuple[StockPieces, StockPieces]:
    """Pieces that the tool reaches with its tip in a box, and those that it does not.

    It also reaches what it still has to remove where it was before.
    """
    stock, track = process.stock, state.process.track
    # The last period enters the track in the next one.
    oldest = int(state.process.queue.row[0]) - process.removal.standing_rows
    waiting = slice(max(oldest, 0) * track.substeps, -track.substeps)
    before = np.asarray(track.poses.tip)[waiting]
    reach = process.removal.window.reach(stock.spacing)
    lower = np.minimum(least, before.min(axis=0)) - reach
    upper = np.maximum(most, before.max(axis=0)) + reach
    return pieces.parted(stock, lower, upper)


def _with_pieces(
    state: RunState, pieces: StockPieces, counts: Sequence[int]
) -> RunState:
    """State at the start of a segment with other pieces of the stock."""
    stock = pieces.stock(state.process.stock, counts)
    cut_by = tuple(rays.poses for rays in stock.families)
    numbered = tuple(rays.numbered() for rays in stock.families)
    return eqx.tree_at(
        lambda s: (s.process.stock.families, s.process.slots, s.cut_by),
        state,
        (numbered, on_device(np.array(pieces.most_on_a_ray(), np.int32)), cut_by),
    )


def _with_stock_of(process: Process, state: RunState) -> Process:
    """Process with the stock of a state: its own would be carried along beside it."""
    return eqx.tree_at(lambda p: p.stock, process, state.process.stock)


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
