"""The process of a command: runs the command line, and ends with its exit code."""

import contextlib
import gc
import os
import sys
import threading
from typing import NoReturn

from .cli import main

# Tracing makes a great many objects that live on, among which Python would search all
# the time for those that do not.
_OBJECTS = 500_000


def run() -> NoReturn:
    """Run the command line, and end the process.

    A thread may still compile what nobody waits for any more. It cannot be interrupted,
    and would crash in an interpreter that is being taken down, so that this one is not.
    """
    gc.set_threshold(_OBJECTS)
    code = main()
    if any(thread.daemon for thread in threading.enumerate()):
        for stream in (sys.stdout, sys.stderr):
            # Who reads it may have gone.
            with contextlib.suppress(OSError):
                stream.flush()
        os._exit(code)
    sys.exit(code)


if __name__ == "__main__":
    run()
