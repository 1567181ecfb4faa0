"""Telling what a user got wrong from what a program got wrong."""

import contextlib
from collections.abc import Iterator

# What commands say of a job that brings a command of its own.
ONLY_SIMULATE = (
    "[program] commanded: found one, but only simulate takes it; leave it out"
)

# What `correct` says of a job whose program it could not write in the end.
NO_TILT = (
    '[output] formats: found "gcode", but the tool tilts, and G-code is written with '
    'X, Y and Z only; correct allows "krl", "rapid" and "apt"'
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


@contextlib.contextmanager
def bad_correction(job: str, purpose: str) -> Iterator[None]:
    """Turn what a correction refuses about its job into `BadInput`.

    Args:
        job: Name of the job.
        purpose: What nothing is found for where the program leaves no error.
    """
    from ...correction import InfeasibleLimit, NothingToCorrect, UnsuitableSettings

    try:
        yield
    except (InfeasibleLimit, UnsuitableSettings) as error:
        raise BadInput(f"{job}: [correction] {error}") from error
    except NothingToCorrect as error:
        raise BadInput(
            f"{job}: found nothing {purpose}: {error} Check the stock's place, the "
            "program's zero and [correction] weight."
        ) from error
