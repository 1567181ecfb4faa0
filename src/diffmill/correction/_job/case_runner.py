"""The methods of a correction, run one after another and remembered."""

import dataclasses
import time
from collections.abc import Callable
from typing import TypeVar

import jax
import numpy as np

from .._core.method import MethodResult
from .._core.problem import Problem
from .._method.checkpoint import (
    Arrays,
    OnCheckpoint,
    below,
    pack_method,
    under,
    unpack_method,
)

# Called with a message and the rms contour error so far [m].
OnProgress = Callable[[str, float], None]
_Found = TypeVar("_Found")


class CaseRecord:
    """Runs methods one after another, keeps what they found, and tells of it."""

    def __init__(
        self,
        on_progress: OnProgress | None,
        on_checkpoint: OnCheckpoint | None,
        resume: Arrays | None,
    ):
        self.methods: dict[str, MethodResult] = {}
        self.wall_time: dict[str, float] = {}
        self.saved: dict[str, np.ndarray] = {}
        # Runs, linearisations and seconds of what has only been prepared.
        self._prepared = (0, 0, 0.0)
        self._on_progress = on_progress
        self._on_checkpoint = on_checkpoint
        self._resume = resume

    def timed(self, run: Callable[[], _Found]) -> _Found:
        """Return what a run finds whose time counts as a part of the next method."""
        start = time.perf_counter()
        # What is dispatched alone has taken no time yet.
        found = jax.block_until_ready(run())
        self._prepared = (0, 0, time.perf_counter() - start)
        return found

    def prepare(
        self,
        name: str,
        method: Callable[..., MethodResult],
        problem: Problem,
        **options: object,
    ) -> MethodResult:
        """Return what a method finds that is no case, only the start of the next one.

        What it cost counts as a part of that.
        """
        self._run(name, method, problem, options, is_start=True)
        found = self.methods.pop(name)
        seconds = self.wall_time.pop(name)
        self._prepared = found.forward_runs, found.linearisations, seconds
        return found

    def run(
        self,
        name: str,
        method: Callable[..., MethodResult],
        problem: Problem,
        **options: object,
    ) -> None:
        """Run a method, or take up what it found before an interruption."""
        self._run(name, method, problem, options, is_start=False)

    def store(self, prefix: str, arrays: Arrays) -> None:
        """Tell what is needed to go on within a method."""
        if self._on_checkpoint is not None:
            self._on_checkpoint({**self.saved, **under(prefix, arrays)})

    def stored(self, prefix: str) -> dict[str, np.ndarray]:
        """Return what was told so before an interruption, or nothing."""
        return below(prefix, self._resume)

    def _run(
        self,
        name: str,
        method: Callable[..., MethodResult],
        problem: Problem,
        options: dict[str, object],
        *,
        is_start: bool,
    ) -> None:
        start = time.perf_counter()
        runs, linearisations, seconds = self._prepared
        self._prepared = (0, 0, 0.0)
        saved = self.stored(f"method/{name}")
        kept = unpack_method(saved, problem, is_start=is_start)
        if kept is not None:
            self.methods[name] = kept
            self.wall_time[name] = float(saved["seconds"])
        else:
            found = method(problem, on_progress=self._on_progress, **options)
            jax.block_until_ready(found)
            self.methods[name] = dataclasses.replace(
                found,
                forward_runs=found.forward_runs + runs,
                linearisations=found.linearisations + linearisations,
            )
            self.wall_time[name] = time.perf_counter() - start + seconds
        if self._on_checkpoint is not None and name != "corrected":
            packed = pack_method(self.methods[name])
            packed["seconds"] = np.asarray(self.wall_time[name])
            self.saved.update(under(f"method/{name}", packed))
            before = {} if self._resume is None else self._resume
            self._on_checkpoint({**before, **self.saved})
        if self._on_progress is not None:
            self._on_progress(name, self.methods[name].measures.rms)
