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
    code = main()
    for stream in (sys.stdout, sys.stderr):
        # Who reads it may have gone.
        with contextlib.suppress(OSError):
            stream.flush()
    os._exit(code)


if __name__ == "__main__":
    run()
