"""Functions compiled once: ahead by another core, or by a process before this one."""

import collections
import os
import threading
import weakref
from collections.abc import Callable
from typing import Any, ClassVar, Generic, ParamSpec, TypeVar, cast

import equinox as eqx
import jax
import jax.export

from ..._arrays import is_traced
from .program_store import (
    TracedProgram,
    is_store_enabled,
    program_name,
    read_program,
    write_program,
)
from .tree_text import HasNoText, arrays_of, is_array, tree_of_text, tree_text

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
        """True for the first caller, who then has to compile."""
        with self._lock:
            is_first, self._is_taken = not self._is_taken, True
        return is_first

    def run(self) -> None:
        """Compile, and tell who waits."""
        try:
            self._compile_it()
        except Exception:
            # The call itself fails in the same way, where somebody can be told.
            pass
        finally:
            self._ended.set()

    def wait(self) -> None:
        """Wait for a compilation that has begun; cancel one that has not."""
        if not self.take():
            self._ended.wait()


class _Workers:
    """Threads that compile, the oldest task first, and end when there is none."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._tasks: collections.deque[_Task] = collections.deque()
        self._count = 0

    def add(self, task: _Task) -> None:
        """Begin a task as soon as a core is free; one core stays with the caller."""
        with self._lock:
            self._tasks.append(task)
            if self._count >= max(1, (os.cpu_count() or 1) - 1):
                return
            self._count += 1
        # A compilation cannot be interrupted, so that none keeps the program alive.
        threading.Thread(target=self._compile_all, daemon=True).start()

    def _compile_all(self) -> None:
        while True:
            with self._lock:
                if not self._tasks:
                    self._count -= 1
                    return
                task = self._tasks.popleft()
            if task.take():
                task.run()


_WORKERS = _Workers()


class CachedJit(Generic[P, R]):
    """A function that is compiled once: before its first call, or by another process.

    XLA compiles on one core without Python's lock: if prepared, another core does so
    while this one traces, runs or compiles something else. Where JAX's compile cache
    has a folder, the traced program is kept in it: a later process does not trace.

    Differentiability: that of the function; under a trace nothing is prepared or kept.
    """

    _all: ClassVar["weakref.WeakSet[CachedJit[Any, Any]]"] = weakref.WeakSet()

    def __init__(self, function: Callable[P, R]):
        self._all.add(self)
        self._plain = function
        self._function = eqx.filter_jit(function)
        self._tasks: list[_Task] = []
        self._programs: dict[str, _StoredProgram | None] = {}
        self.__doc__ = function.__doc__

    def prepare(self, *args: P.args, **kwargs: P.kwargs) -> None:
        """Compile for arguments of the same structure, shapes and types as these.

        Under a trace nothing happens.
        """
        if is_traced((args, kwargs)):
            return

        def compile_it() -> None:
            program = self._program((args, kwargs))
            if program is None:
                self._function.lower(*args, **kwargs).compile()  # pyright: ignore[reportFunctionMemberAccess]
            else:
                program.compiled(self._plain.__name__)

        self._tasks.append(task := _Task(compile_it))
        _WORKERS.add(task)

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Call the function, when what is being compiled for it is ready."""
        if is_traced((args, kwargs)):
            return self._function(*args, **kwargs)
        while self._tasks:
            self._tasks.pop().wait()
        program = self._program((args, kwargs))
        if program is None:
            return self._function(*args, **kwargs)
        run = program.compiled(self._plain.__name__)
        return program.result_of(run(*arrays_of((args, kwargs))))

    def forget(self) -> None:
        """Free the programs that a store has: up to 150 MB each, of a whole run.

        The next call reads its own again, which takes a second.
        """
        self._programs.clear()

    @classmethod
    def forget_all(cls) -> None:
        """Free the programs of all functions, as `forget`."""
        for function in cls._all:
            function.forget()

    def _program(self, arguments: object) -> "_StoredProgram | None":
        """Program for such arguments, from the store or traced; None without a store.

        Only a function that this package knows by its name has a program in the store.
        """
        module, name = self._plain.__module__, self._plain.__qualname__
        is_ours = module.partition(".")[0] == __name__.partition(".")[0]
        if not (is_ours and "<" not in name and is_store_enabled()):
            return None
        if not _are_on_default_device(arguments):
            return None
        try:
            key = program_name(f"{module}:{name}", tree_text(arguments))
        except HasNoText:
            return None
        if key not in self._programs:
            program = read_program(key)
            if program is None:
                program = self._traced(arguments)
                if program is not None:
                    write_program(key, program)
            self._programs[key] = program and _StoredProgram(program)
        return self._programs[key]

    def _traced(self, arguments: object) -> TracedProgram | None:
        """Traced program; None where it cannot be stored.

        It then holds an object that is not known by its name, or calls one that JAX
        does not export. An error of the function itself is raised where it is called.
        """
        leaves, structure = jax.tree.flatten(arguments)
        results: list[str] = []

        def of_arrays(*arrays: jax.Array) -> list[Any]:
            given = iter(arrays)
            filled = [next(given) if is_array(x) else x for x in leaves]
            args, kwargs = jax.tree.unflatten(structure, filled)
            result: Any = cast(Any, self._plain)(*args, **kwargs)
            results.append(tree_text(result))
            return arrays_of(result)

        shapes = [
            jax.ShapeDtypeStruct(x.shape, jax.dtypes.canonicalize_dtype(x.dtype))
            for x in leaves
            if is_array(x)
        ]
        try:
            exported = jax.export.export(jax.jit(of_arrays))(*shapes)
        except (HasNoText, NotImplementedError, ValueError):
            return None
        return TracedProgram(exported, results[0])


class _StoredProgram:
    """A traced program, of which only the arrays are arguments."""

    def __init__(self, program: TracedProgram):
        self._exported, self._result = program
        self._lock = threading.Lock()
        self._compiled: jax.stages.Compiled | None = None

    def compiled(self, name: str) -> jax.stages.Compiled:
        """Compiled program, for arrays that are committed to a device or are not."""
        with self._lock:
            if self._compiled is None:
                call = lambda *arrays: self._exported.call(*arrays)
                call.__name__ = name
                avals = self._exported.in_avals
                shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in avals]
                self._compiled = jax.jit(call).lower(*shapes).compile()
            return self._compiled

    def result_of(self, arrays: list[jax.Array]) -> Any:
        """Result of the function that consists of these arrays."""
        return tree_of_text(self._result, arrays)


def _are_on_default_device(arguments: object) -> bool:
    """True if all arrays are on the device for which a program is traced."""
    arrays = [x for x in jax.tree.leaves(arguments) if isinstance(x, jax.Array)]
    devices = {device for x in arrays for device in x.devices()}
    default = jax.config.jax_default_device or jax.devices()[0]  # pyright: ignore[reportAttributeAccessIssue]
    # A program is traced for the platform of the backend.
    is_of_backend = getattr(default, "platform", default) == jax.default_backend()
    return is_of_backend and devices <= {default}
