"""Checkpoints of a long run: its finished segments, and the state behind the last.

They are plain arrays by name. Those below `rows/` belong to one segment and are told
once, so that what is written for a segment does not grow with the path; all others
replace those that were told before.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias, TypeVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Int, PyTree

from ..._arrays import Arrays, above, below, named_leaves, on_device
from ...process import RemovedVolume
from ...workpiece import StockPieces
from .._machine.machine import RunState
from .path_segments import PathSegment

# Called with what a finished segment adds to a checkpoint.
OnCheckpoint: TypeAlias = Callable[[Arrays], None]
_Tree = TypeVar("_Tree")


class RunPlace(eqx.Module):
    """Place of a run behind a segment, from which it goes on.

    Attributes:
        state: State of the machine and the stock.
        teller: State of the controller that tells the machine where to go, a tree.
        standing_count: As of `RunSegment`.
        apart: Pieces of the stock that the segment could not reach, which its state
            does not have.
    """

    state: RunState
    teller: PyTree
    standing_count: Int[Array, ""]
    apart: StockPieces


class SegmentOutputs(eqx.Module):
    """Outputs of a segment on the host.

    Attributes:
        rows: Its rows, a tree.
        removed: As of `RunSegment`.
        has_failed: As of `RunSegment`.
        is_finite: Whether all that was computed is finite, shape ().
    """

    rows: PyTree
    removed: RemovedVolume
    has_failed: Bool[np.ndarray | Array, " period"]
    is_finite: Bool[np.ndarray, ""]

    @classmethod
    def like(cls, rows: PyTree) -> "SegmentOutputs":
        """Outputs of the same structure as those with such rows.

        Args:
            rows: A tree of rows.
        """
        index, volume = (on_device(np.zeros((0, 1), x)) for x in (np.int32, np.float32))
        removed = RemovedVolume(index, volume, volume)
        return cls(rows, removed, np.zeros(0, bool), np.asarray(True))


class RunCheckpoint(NamedTuple):
    """Checkpoint of one of the runs of a job.

    Attributes:
        run: Name of the run.
        write: Called with what each segment adds; None to keep nothing.
        resume: What it was called with, from which the run goes on; None to begin.
    """

    run: str = ""
    write: OnCheckpoint | None = None
    resume: Arrays | None = None

    def outputs(
        self, segment: PathSegment, like: SegmentOutputs
    ) -> SegmentOutputs | None:
        """Outputs of a segment that was finished before; None if it was not.

        Args:
            segment: The segment.
            like: Outputs of the same structure.

        Raises:
            ValueError: Segments had another length.
        """
        found = _filled(like, below(self._rows(segment), self.resume))
        if found is not None and len(found.has_failed) != segment.length - 1:
            raise ValueError(
                "Argument `resume` must have segments of "
                f"{segment.length - 1} tooth periods, but has some of "
                f"{len(found.has_failed)}."
            )
        return found

    def place(self, like: RunPlace) -> RunPlace | None:
        """Place behind the last segment that was finished before; None without any.

        Args:
            like: A place of the same structure.
        """
        found = _filled(like, below(self._end, self.resume))
        found = found or _filled(like, below(self._state, self.resume))
        return None if found is None else jax.tree.map(on_device, found)

    def put(
        self, segment: PathSegment, outputs: SegmentOutputs, place: RunPlace
    ) -> None:
        """Keep a segment that is finished.

        Args:
            segment: The segment.
            outputs: Its outputs.
            place: The place behind it.
        """
        if self.write is None:
            return
        is_last = segment.first + segment.row_count == segment.total
        rows = above(self._rows(segment), outputs)
        # Where a run has ended is asked for while the next one runs.
        self.write(rows | above(self._end if is_last else self._state, place))

    def _rows(self, segment: PathSegment) -> str:
        return f"rows/{self.run}/{segment.first}"

    @property
    def _end(self) -> str:
        return f"rows/{self.run}/end"

    @property
    def _state(self) -> str:
        return f"state/{self.run}"


def _filled(like: _Tree, arrays: Arrays) -> _Tree | None:
    """Tree of the same structure from its leaves; None if there are none."""
    if not arrays:
        return None
    names = named_leaves(like)
    if names.keys() != arrays.keys():
        raise ValueError("Argument `resume` must be of the same job, but is not.")
    return jax.tree.unflatten(jax.tree.structure(like), [arrays[x] for x in names])
