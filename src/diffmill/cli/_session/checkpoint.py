"""Checkpoints of a long correction, and its resumption."""

import os
import pathlib
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from .errors import BadInput
from .progress import Progress

if TYPE_CHECKING:
    from ..._job import Job


class Checkpoint:
    """The checkpoint beside a folder of results.

    Attributes:
        path: Its file, `<folder>.checkpoint`.
        resumed: What it held, or None for a run from the beginning.
    """

    def __init__(self, folder: pathlib.Path, job: "Job"):
        from ...io import fingerprint

        folder = pathlib.Path(os.path.realpath(folder))
        self.path = folder.with_name(f"{folder.name}.checkpoint")
        self.resumed: Mapping[str, np.ndarray] | None = None
        self._fingerprint = fingerprint(job)

    def open(self, *, resume: bool, force: bool, progress: Progress) -> None:
        """Read what an earlier run has kept, or see that none is overwritten.

        Args:
            resume: Whether to go on from the checkpoint.
            force: Whether an earlier one may be replaced.
            progress: Told what is used and what was refused.

        Raises:
            BadInput: A checkpoint is there and neither is asked for.
            ValueError: The checkpoint is of another job, or damaged and alone.
        """
        from ...io import has_checkpoint, latest_checkpoint

        if not resume:
            if has_checkpoint(self.path) and not force:
                raise BadInput(
                    f"{self.path}: found what an interrupted run has kept; --resume "
                    "goes on from there, --force starts anew"
                )
            return
        found, notes = latest_checkpoint(self.path, job_fingerprint=self._fingerprint)
        for note in notes:
            progress.say(f"warning: {note}")
        if found is None:
            progress.say(f"note: no checkpoint at {self.path}; the run starts anew")
        self.resumed = found

    def write(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Keep what has been found so far."""
        from ...io import write_checkpoint

        self.path.parent.mkdir(parents=True, exist_ok=True)
        write_checkpoint(self.path, arrays, job_fingerprint=self._fingerprint)

    def remove(self) -> None:
        """Remove it after the results have been written."""
        from ...io import remove_checkpoint

        remove_checkpoint(self.path)
