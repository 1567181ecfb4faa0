"""Checkpoints of long work, and its resumption."""

import pathlib
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ..._results_folder import ResultsFolder
from .errors import BadInput
from .progress import Progress

if TYPE_CHECKING:
    from ..._job import Job
    from ...config import MeasuredJob

# Name of the time of the run in a checkpoint [s].
_SPENT = "spent_s"
# Beginning of the names of arrays that are told once.
_ONCE = "rows/"


class Checkpoint:
    """The checkpoint beside a folder of results.

    Attributes:
        file: Its file, `<folder>.checkpoint`.
        resumed: Its arrays, or None for a run from the beginning.
        spent: Time of the run until then [s].
    """

    def __init__(
        self,
        command: str,
        folder: pathlib.Path,
        job: "Job | MeasuredJob",
        progress: Progress,
    ):
        from ...io import CheckpointFile

        path = ResultsFolder.of(folder).checkpoint
        self.file = CheckpointFile.of_job(path, (command, job))
        self.resumed: Mapping[str, np.ndarray] | None = None
        self.spent = 0.0
        self._is_ours = False
        self._began = time.perf_counter()
        self._progress, self._has_failed = progress, False
        self._parts: tuple[str, ...] = ()

    def open(self, *, resume: bool, force: bool) -> None:
        """Read the checkpoint of an earlier run, or refuse to overwrite it.

        Args:
            resume: True to go on from the checkpoint.
            force: True to replace an earlier one.

        Raises:
            BadInput: A checkpoint is there and neither is asked for.
            ValueError: The checkpoint is of another job, or damaged and alone.
        """
        if not resume:
            if self.file.exists() and not force:
                raise BadInput(
                    f"{self.file.path}: found what an interrupted run has kept; "
                    "--resume goes on from there, --force starts anew"
                )
            return
        latest = self.file.latest()
        for note in latest.notes:
            self._progress.write(f"warning: {note}")
        arrays = latest.arrays
        if arrays is None:
            self._progress.write(
                f"note: no checkpoint at {self.file.path}; the run starts anew"
            )
            return
        self.spent = float(arrays.get(_SPENT, 0.0))
        self.resumed, self._parts = arrays, latest.parts
        self._is_ours = True

    def write(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Write the arrays so far; where that fails, the run goes on.

        Args:
            arrays: Plain arrays by name. Those of rows are kept beside those of earlier
                calls, all others replace them.
        """
        spent = self.spent + time.perf_counter() - self._began
        rows = {name: x for name, x in arrays.items() if name.startswith(_ONCE)}
        others = {name: x for name, x in arrays.items() if name not in rows}
        if rows and self._has_failed:
            # Without rows that could not be written none goes on.
            return
        try:
            if rows:
                self._parts += (self.file.add_part(rows),)
            self.file.write({**others, _SPENT: np.asarray(spent)}, self._parts)
        except OSError as error:
            if not self._has_failed:
                self._progress.write(
                    f"warning: the checkpoint {self.file.path} cannot be written: "
                    f"{error.strerror}; the run goes on, but after an interruption "
                    "the steps since the last checkpoint are lost"
                )
            self._has_failed = True
            return
        self._is_ours = True

    def interruption_text(self) -> str:
        """Sentence on what an interruption leaves before there are results."""
        if not self.file.exists():
            return "no results were written"
        return (
            f"no results were written, but {self.file.path} keeps what was found: the "
            "same command with --resume goes on from there"
        )

    def remove(self) -> None:
        """Remove it after the results have been written."""
        self.file.remove()

    def remove_own(self) -> None:
        """Remove it if this run has written it or goes on from it."""
        if self._is_ours:
            self.remove()
