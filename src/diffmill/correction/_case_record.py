"""The methods of a correction, run one after another and remembered."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from ._memory import (
    Arrays,
    OnCheckpoint,
    below,
    pack_method,
    under,
    unpack_method,
)
from ._method import Corrected
from ._problem import Problem

# Called with a message and the rms contour error so far [m].
OnProgress = Callable[[str, float], None]


class CaseRecord:
    """Runs methods one after another, keeps what they found, and tells of it."""

    def __init__(
        self,
        on_progress: OnProgress | None,
        on_checkpoint: OnCheckpoint | None,
        resume: Arrays | None,
    ):
        self.methods: dict[str, Corrected] = {}
        self.wall_time: dict[str, float] = {}
        self.saved: dict[str, np.ndarray] = {}
        self._on_progress = on_progress
        self._on_checkpoint = on_checkpoint
        self._resume = resume

    def prepare(
        self, name: str, method: Any, problem: Problem, **options: Any
    ) -> Corrected:
        """Return what a method finds that is no case, only a start."""
        self.run(name, method, problem, **options)
        del self.wall_time[name]
        return self.methods.pop(name)

    def run(self, name: str, method: Any, problem: Problem, **options: Any) -> None:
        """Run a method, or take up what it found before an interruption."""
        start = time.perf_counter()
        kept = unpack_method(below(f"method/{name}", self._resume), problem)
        if kept is not None:
            self.methods[name], self.wall_time[name] = kept
        else:
            found = method(problem, on_progress=self._on_progress, **options)
            self.methods[name] = found
            self.wall_time[name] = time.perf_counter() - start
        if self._on_checkpoint is not None and name != "corrected":
            packed = pack_method(self.methods[name], self.wall_time[name])
            self.saved.update(under(f"method/{name}", packed))
            before = {} if self._resume is None else self._resume
            self._on_checkpoint({**before, **self.saved})
        if self._on_progress is not None:
            self._on_progress(name, self.methods[name].measures.rms)
