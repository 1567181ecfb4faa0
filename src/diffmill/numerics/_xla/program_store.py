"""Traced programs on disk, beside JAX's cache of compiled ones.

JAX stores what XLA has compiled, but a new process traces the Python code again to find
it. Here the traced program is stored too, under a digest of all that it depends on.
"""

import contextlib
import functools
import hashlib
import importlib.metadata
import json
import os
import pathlib
import tempfile
import time
from typing import NamedTuple

import jax
import jax.export

from ..._jax_config import PROGRAMS

# Number of programs in the store; of more, the ones that were used longest ago go.
_MOST_PROGRAMS = 400
# Time at which this process began, or a little later [s].
_PROCESS_START = time.time()
# Parts of the names of JAX's settings that change no program.
_IRRELEVANT_SETTINGS = (
    *("compilation_cache", "persistent_cache", "log_", "explain_", "traceback"),
)


def is_store_enabled() -> bool:
    """True where JAX, too, has a folder for what it compiles."""
    debugs = jax.config.jax_debug_nans or jax.config.jax_disable_jit  # pyright: ignore[reportAttributeAccessIssue]
    return _folder() is not None and not debugs and _sources() is not None


def program_name(function: str, arguments: str) -> str:
    """Name of a program: a digest of all that it depends on.

    Args:
        function: Module and name of the function.
        arguments: The text of its arguments.
    """
    settings = {
        name: str(getattr(jax.config, name, value))
        for name, value in sorted(jax.config.values.items())
        if not any(part in name for part in _IRRELEVANT_SETTINGS)
    }
    inputs = [function, arguments, _sources(), jax.default_backend(), settings]
    return hashlib.sha256(json.dumps(inputs).encode()).hexdigest()


class TracedProgram(NamedTuple):
    """A traced program, and the text of its result."""

    exported: jax.export.Exported
    result: str


def read_program(name: str) -> TracedProgram | None:
    """Program from the store, or None where there is none or its file is damaged.

    Args:
        name: As `program_name` gives it.
    """
    folder = _folder()
    if folder is None:
        return None
    path = folder / name
    try:
        digest, body = path.read_bytes().split(b"\n", 1)
        if hashlib.sha256(body).hexdigest().encode() != digest:
            return None
        result, code = body.split(b"\n", 1)
        exported = jax.export.deserialize(bytearray(code))
        os.utime(path)
    except (OSError, ValueError):
        return None
    return TracedProgram(exported, result.decode())


def write_program(name: str, program: TracedProgram) -> None:
    """Write a program to the store, if its folder can be written to.

    Args:
        name: As `program_name` gives it.
        program: The program.
    """
    folder = _folder()
    if folder is None:
        return
    body = program.result.encode() + b"\n" + program.exported.serialize()
    digest = hashlib.sha256(body).hexdigest().encode()
    with contextlib.suppress(OSError):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        # Another process may read or write the same: it sees the whole or nothing.
        handle, part = tempfile.mkstemp(dir=folder, prefix="part-")
        with os.fdopen(handle, "wb") as file:
            file.write(digest + b"\n" + body)
        pathlib.Path(part).replace(folder / name)
        files = sorted(folder.iterdir(), key=_last_use)
        for path in files[: max(0, len(files) - _MOST_PROGRAMS)]:
            path.unlink(missing_ok=True)


def _last_use(path: pathlib.Path) -> float:
    try:
        return path.stat().st_mtime
    except FileNotFoundError:
        return 0.0


def _folder() -> pathlib.Path | None:
    parent: str | None = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    # A cache in a bucket is JAX's own affair.
    return None if parent is None or "://" in parent else pathlib.Path(parent, PROGRAMS)


@functools.cache
def _sources() -> str | None:
    """Digest of the traced code: this package and the libraries that it traces.

    None if a source has changed since this process began, which may trace the old one.
    """
    digest, root = hashlib.sha256(), pathlib.Path(__file__).parents[2]
    for path in sorted(root.rglob("*.py")):
        if path.stat().st_mtime > _PROCESS_START:
            return None
        digest.update(str(path.relative_to(root)).encode() + b"\0" + path.read_bytes())
    for name in ("jax", "jaxlib", "equinox", "numpy"):
        digest.update(f"{name} {importlib.metadata.version(name)}\n".encode())
    digest.update(os.environ.get("XLA_FLAGS", "").encode())
    return digest.hexdigest()
