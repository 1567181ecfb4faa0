"""Compiled functions that another core compiles before they are called."""

import collections
import os
import threading
from collections.abc import Callable
from typing import Generic, ParamSpec, TypeVar

import equinox as eqx
import jax
import jax.core

P = ParamSpec("P")
R = TypeVar("R")


class _Task:
    """A compilation that waits, runs or has ended."""

    def __init__(self, compile_it: Callable[[], object]):
        self._compile_it = compile_it
        self._lock = threading.Lock()
        self._is_taken = False
        self._ended = threading.Event()

    def take(self) -> bool:
        """Return whether whoever asks is the first, and so has it to do."""
        with self._lock:
            is_first, self._is_taken = not self._is_taken, True
        return is_first

    def do(self) -> None:
        """Compile."""
        try:
            self._compile_it()
        except Exception:
            # The call itself fails in the same way, where somebody can be told.
            pass
        finally:
            self._ended.set()

    def wait(self) -> None:
        """Return when what has begun has ended; what has not need not any more."""
        if not self.take():
            self._ended.wait()


class _Workers:
    """Threads that compile, the oldest task first, and end when there is none."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._tasks: collections.deque[_Task] = collections.deque()
        self._count = 0

    def add(self, task: _Task) -> None:
        """Begin a task as soon as a core is free; one is left to the caller."""
        with self._lock:
            self._tasks.append(task)
            if self._count >= max(1, (os.cpu_count() or 1) - 1):
                return
            self._count += 1
        # A compilation cannot be interrupted, so that none keeps the program alive.
        threading.Thread(target=self._work, daemon=True).start()

    def _work(self) -> None:
        while True:
            with self._lock:
                if not self._tasks:
                    self._count -= 1
                    return
                task = self._tasks.popleft()
            if task.take():
                task.do()


_WORKERS = _Workers()


class CompiledAhead(Generic[P, R]):
    """A function compiled by `equinox.filter_jit`, before its first call if prepared.

    XLA compiles on one core without Python's lock: meanwhile another one traces, runs
    or compiles something else.
    """

    def __init__(self, function: Callable[P, R]):
        self._function = eqx.filter_jit(function)
        self._tasks: list[_Task] = []
        self.__doc__ = function.__doc__

    def prepare(self, *args: P.args, **kwargs: P.kwargs) -> None:
        """Compile for arguments of the same structure, shapes and types as these.

        Under a trace nothing happens.
        """
        if any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves((args, kwargs))):
            return
        compile_it = lambda: self._function.lower(*args, **kwargs).compile()  # pyright: ignore[reportFunctionMemberAccess]
        self._tasks.append(task := _Task(compile_it))
        _WORKERS.add(task)

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Call the function, when what is being compiled for it is ready."""
        while self._tasks:
            self._tasks.pop().wait()
        return self._function(*args, **kwargs)
