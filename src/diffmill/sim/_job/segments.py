"""Long runs in segments of one length: programs and devices hold one at a time.

The rows of a segment are taken to the host before the next one runs, which goes on
from its state. What goes from segment to segment on the device is that state alone: the
stock, the poses that wait for removal and those that it looks back on.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PyTree

from ..._arrays import on_device
from ...numerics import CachedJit
from ...process import Process
from ...workpiece import Rays
from .._machine.machine import (
    AbstractMachine,
    Removal,
    RunEnd,
    RunSegment,
    RunState,
    TurnChips,
    outcome,
)

# From slots of a ray along x, y and z that are too few to more; None for no more.
MoreSlots: TypeAlias = Callable[[Sequence[int]], Sequence[int] | None]


class PathSegment(NamedTuple):
    """Some rows of a path that are run together.

    Attributes:
        first: Row of the path at which they begin, the last of the segment before.
        row_count: How many of them there are.
        length: To how many they are padded; all segments of a path have one length.
        total: Rows of the path.
    """

    first: int
    row_count: int
    length: int
    total: int

    def rows(self, before: int = 0, behind: int = 0) -> Int[np.ndarray, " row"]:
        """Rows of the path, with more at either end; the outermost come again.

        Args:
            before: How many more before the first.
            behind: How many more behind the last.
        """
        rows = np.arange(self.first - before, self.first + self.length + behind)
        return np.clip(rows, 0, self.total - 1)

    def put(self, path: PyTree, rows: PyTree) -> None:
        """Put rows of the segment into arrays of the whole path.

        Row 0 of a segment belongs to the one before, if there is one.

        Args:
            path: Arrays of the path, on the host.
            rows: Arrays of the segment, in the same tree.
        """
        own = min(self.first, 1)

        def put(path: np.ndarray, rows: np.ndarray | Array) -> None:
            part = np.asarray(rows)[own : self.row_count]
            path[self.first + own : self.first + self.row_count] = part

        jax.tree.map(put, path, rows)


@dataclasses.dataclass(frozen=True)
class Segments:
    """Segments of a long path.

    Attributes:
        total: Rows of the path.
        length: Rows of a segment; two that follow each other share one.
    """

    total: int
    length: int

    def __iter__(self) -> Iterator[PathSegment]:
        """Segments in the order of the path."""
        for first in range(0, self.total - 1, self.length - 1):
            count = min(self.length, self.total - first)
            yield PathSegment(first, count, self.length, self.total)


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


def run_in_segments(
    machine: AbstractMachine,
    process: Process,
    segments: Segments,
    command: Callable[[PathSegment], PyTree],
    take: Callable[[PathSegment, RunSegment], None],
    more_slots: MoreSlots,
) -> SegmentedRun:
    """Run a machine segment by segment.

    Args:
        machine: The machine.
        process: The process.
        segments: The segments of the path.
        command: Returns what the machine is told in a segment, as for `run_segment`;
            called in the order of the segments.
        take: Takes the rows of a segment to the host.
        more_slots: Returns the slots with which a segment is run again in which a ray
            ran out of them.

    Returns:
        The end of the run.

    **Differentiability**: runs on the host.
    """
    total, dtype = segments.total, np.dtype(process.stock.origin.dtype)
    volume, by_shank = np.zeros((2, total), dtype)
    has_failed, is_finite = np.zeros(total, bool), True
    overlap, ran, state, last = 0.0, None, None, 0
    for segment in segments:
        told = command(segment)
        if state is None:
            state = _begun(machine, process, told)
        # Its own stock would be carried along beside that of the state.
        process = eqx.tree_at(lambda p: p.stock, process, state.process.stock)
        rows = on_device(np.asarray(segment.row_count, np.int32))
        ran = _segment(machine, process, told, state, rows)
        while bool(ran.state.process.has_overflow):
            counts = more_slots(process.stock.interval_counts)
            if counts is None:
                break
            state = _widened(state, counts)
            process = eqx.tree_at(lambda p: p.stock, process, state.process.stock)
            ran = _segment(machine, process, told, state, rows)
        state, removed = ran.state, jax.device_get(ran.removed)
        if segment.first == 0:
            # The first period removes nothing but what the tool stood in.
            overlap = removed.volume[0].sum(dtype=dtype)
            removed = jax.tree.map(lambda x: x[1:], removed)
        _add_volumes(volume, segment.first, removed.pose, removed.volume)
        _add_volumes(by_shank, segment.first, removed.pose, removed.by_shank)
        own = slice(segment.first + 1, segment.first + segment.row_count)
        has_failed[own] = np.asarray(ran.has_failed)[: segment.row_count - 1]
        counted = [np.asarray(x)[: segment.row_count] for x in (ran.actual, ran.force)]
        is_finite &= all(np.isfinite(x).all() for x in counted)
        last = segment.first + segment.row_count - 1
        take(segment, ran)
    assert ran is not None and state is not None
    process = eqx.tree_at(lambda p: p.stock, process, state.process.stock)
    end = _finished(machine, process, state, ran.standing_count)
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
    return SegmentedRun(overlap, removal, machine.chips(state.machine))


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
) -> RunSegment:
    return machine.run_segment(process, command, state, row_count)


@CachedJit
def _finished(
    machine: AbstractMachine,
    process: Process,
    state: RunState,
    standing_count: Int[Array, ""],
) -> RunEnd:
    return machine.finish_run(process, state, standing_count)
