"""Telling what a user got wrong from what a program got wrong."""

import contextlib
from collections.abc import Iterator

# What commands say of a job that brings a command of its own.
ONLY_SIMULATE = (
    "[program] commanded: found one, but only simulate takes it; leave it out"
)


class BadInput(Exception):
    """Raise when a user's input is refused; nothing has been written."""


@contextlib.contextmanager
def bad_input() -> Iterator[None]:
    """Turn a `ValueError` or unreadable file into `BadInput`.

    Only reading and checking of input belongs in it: the same error from within a
    computation is a fault of the program and must show as one.
    """
    try:
        yield
    except (ValueError, OSError) as error:
        raise BadInput(str(error)) from error
