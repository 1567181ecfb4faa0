"""The process of a command: runs the command line, and ends with its exit code."""

import contextlib
import gc
import os
import sys
from typing import NoReturn

from .cli import main

# Tracing makes a great many objects that live on, among which Python would search all
# the time for those that do not.
_OBJECTS = 500_000


def run() -> NoReturn:
    """Run the command line, and end the process.

    The interpreter is not taken down: it would look at every object once more, for a
    second. Nor could it be where a thread still compiles what nobody waits for any
    more, which cannot be interrupted. What a command writes is closed by then.
    """
    gc.set_threshold(_OBJECTS)
    try:
        code = main()
    except KeyboardInterrupt:
        # A second one, while the first was told.
        code = 1
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
