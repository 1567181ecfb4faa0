"""The process of a command: runs the command line, and ends with its exit code."""

import contextlib
import gc
import os
import signal
import sys
from typing import NoReturn

from ._jax_config import limit_threads

# Tracing makes a great many objects that live on, among which Python would search all
# the time for those that do not.
_OBJECTS = 500_000


def main() -> int:
    """Import the command line, which takes a moment, and run it."""
    from .cli import main as run_command

    return run_command()


def _interrupt(number: int, frame: object) -> NoReturn:
    raise KeyboardInterrupt


def run() -> NoReturn:
    """Run the command line, and end the process.

    The interpreter is not taken down: it would look at every object once more, for a
    second. Nor could it be where a thread still compiles what nobody waits for any
    more, which cannot be interrupted. What a command writes is closed by then.
    """
    # From the first moment on, also while the command line is imported.
    signal.signal(signal.SIGTERM, _interrupt)
    # Before NumPy loads its LAPACK, as SciPy does later.
    limit_threads()
    gc.set_threshold(_OBJECTS)
    try:
        code = main()
    except KeyboardInterrupt:
        # One before the command began, or a second one while the first was told.
        print("error: interrupted", file=sys.stderr)
        code = 1
    # The code is known: a signal now ends the process without a trace.
    for number in (signal.SIGINT, signal.SIGTERM):
        if callable(signal.getsignal(number)):
            signal.signal(number, signal.SIG_DFL)
    for stream in filter(None, (sys.stdout, sys.stderr)):
        try:
            stream.flush()
        except BrokenPipeError:
            # Who reads it has gone.
            continue
        except OSError as error:
            code = code or 1
            with contextlib.suppress(OSError):
                reason = error.strerror or str(error)
                os.write(2, f"error: the output is not complete: {reason}\n".encode())
    os._exit(code)


if __name__ == "__main__":
    run()
