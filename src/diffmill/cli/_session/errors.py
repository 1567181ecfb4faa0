"""Errors of a user, apart from errors of the program."""

import contextlib
import pathlib
from collections.abc import Callable, Iterator

from ..._results_folder import ResultsFolder

# Refusal of a job that brings a command of its own.
ONLY_SIMULATE = (
    "[program] commanded: found one, but only simulate takes it; leave it out"
)

# Refusal of `correct` for a job whose program it could not write in the end.
NO_TILT = (
    '[output] formats: found "gcode", but the tool tilts, and G-code is written with '
    'X, Y and Z only; correct allows "krl", "rapid" and "apt"'
)


class BadInput(Exception):
    """Raise when a user's input is refused; nothing has been written."""


class Interrupted(Exception):
    """Raise for an interruption; the message names the files that it leaves."""


@contextlib.contextmanager
def interruption_leaves(describe: Callable[[], str]) -> Iterator[None]:
    """Turn an interruption into `Interrupted`.

    Args:
        describe: Text on the files that are there, asked for after an interruption.
    """
    try:
        yield
    except KeyboardInterrupt as error:
        raise Interrupted(describe()) from error


@contextlib.contextmanager
def locked_folder(folder: pathlib.Path) -> Iterator[str]:
    """Lock a folder of results; remove files that killed runs left.

    Yields:
        A note where the file system knows no locks, else an empty text.

    Raises:
        BadInput: Another run writes there.
    """
    with contextlib.ExitStack() as stack:
        with bad_input():
            note = stack.enter_context(ResultsFolder.of(folder).locked())
        yield note


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
    """Turn a correction's refusal of its job into `BadInput`.

    Args:
        job: Name of the job.
        purpose: Purpose for which nothing is found where the program leaves no error.
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
