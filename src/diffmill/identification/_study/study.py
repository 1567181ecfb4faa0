"""What all studies share."""

from collections.abc import Callable

# Told what is being done.
OnProgress = Callable[[str], None]


class StudyError(ValueError):
    """Measurements that a study cannot fit; the message names them."""


def silent(message: str) -> None:
    """Take a message and do nothing."""
    del message
