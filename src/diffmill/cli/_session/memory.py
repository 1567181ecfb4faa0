"""Memory that a command has freed, and that the C library keeps for later."""

import contextlib
import ctypes


def give_back_memory() -> None:
    """Return freed memory to the system.

    A compiled program takes several times its final size while it is made, or read.
    Where the C library has no such function nothing is done.
    """
    with contextlib.suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)
