"""The methods of a correction, run one after another and remembered."""

import contextlib
import dataclasses
import functools
import time
from collections.abc import Callable, Iterator

import jax

from .._core.method import MethodResult
from .._core.problem import Problem
from .._method.checkpoint import (
    Arrays,
    CaseState,
    CorrectionState,
    OnCheckpoint,
    below,
    pack,
)

# Called with a message and the rms contour error so far [m].
OnProgress = Callable[[str, float], None]


class CaseRecord:
    """Runs methods one after another, and tells and remembers their outcomes.

    Attributes:
        methods: Outcomes of the cases, by name.
        wall_time: Time of each [s], with that of the preparations before it.
    """

    def __init__(
        self,
        on_progress: OnProgress | None,
        on_checkpoint: OnCheckpoint | None,
        resume: Arrays | None,
    ):
        self.methods: dict[str, MethodResult] = {}
        self.wall_time: dict[str, float] = {}
        # Runs, linearisations and seconds of preparations, part of the next case.
        self._prepared = (0, 0, 0.0)
        self._state = CorrectionState({}, {})
        self._on_progress = on_progress
        self._on_checkpoint = on_checkpoint
        self._resume = {} if resume is None else resume

    @contextlib.contextmanager
    def timed_preparation(self) -> Iterator[None]:
        """Time of a block of statements, as a part of that of the next case."""
        start = time.perf_counter()
        yield
        self._prepared = (0, 0, time.perf_counter() - start)

    def run(
        self,
        name: str,
        method: Callable[..., MethodResult],
        problem: Problem,
        *,
        is_case: bool = True,
        is_search: bool = False,
        **options: object,
    ) -> MethodResult:
        """Outcome of a method, run or taken up from before an interruption.

        Args:
            name: Its name.
            method: The method.
            problem: The problem.
            is_case: False for a preparation of the next case, whose costs count as a
                part of that.
            is_search: True for an optimiser, which tells its state after every step and
                goes on from one.
            options: Further ones of the method.
        """
        start = time.perf_counter()
        runs, linearisations, seconds = self._prepared
        known = CaseState.from_arrays(below(f"method/{name}", self._resume))
        # One that did not succeed runs again for its exact outcome; a start need not.
        if known is not None and (known.is_successful or not is_case):
            outcome, seconds = known.outcome(problem), known.seconds
        else:
            if is_search:
                options["on_checkpoint"] = functools.partial(
                    self._checkpoint_search, name
                )
                options["resume"] = below(f"search/{name}", self._resume) or None
            outcome = method(problem, on_progress=self._on_progress, **options)
            jax.block_until_ready(outcome)
            outcome = dataclasses.replace(
                outcome,
                forward_runs=outcome.forward_runs + runs,
                linearisations=outcome.linearisations + linearisations,
            )
            seconds += time.perf_counter() - start
        if is_case:
            self._prepared = (0, 0, 0.0)
            self.methods[name], self.wall_time[name] = outcome, seconds
        else:
            self._prepared = outcome.forward_runs, outcome.linearisations, seconds
        if name != "corrected":
            methods = {**self._state.method, name: CaseState.of(outcome, seconds)}
            self._state = CorrectionState(methods, {})
            self._write_checkpoint()
        if self._on_progress is not None:
            self._on_progress(name, outcome.measures.rms)
        return outcome

    def _checkpoint_search(self, name: str, arrays: Arrays) -> None:
        self._state = CorrectionState(self._state.method, {name: arrays})
        self._write_checkpoint()

    def _write_checkpoint(self) -> None:
        if self._on_checkpoint is not None:
            # With the search that is resumed, until its own next step replaces it.
            self._on_checkpoint({**self._resume, **pack(self._state)})
