"""Showing how far a run is."""

import time
from types import TracebackType

from rich.console import Console


class Progress:
    """A status line on a terminal; one line per message where there is none.

    Attributes:
        is_quiet: Whether nothing is shown.
    """

    def __init__(self, *, is_quiet: bool = False):
        self.is_quiet = is_quiet
        # Results of a pipe go to stdout, so that progress must not.
        self._console = Console(stderr=True, highlight=False, soft_wrap=True)
        self._status = self._console.status("starting")
        self._start = time.perf_counter()

    def __enter__(self) -> "Progress":
        """Show the status line."""
        self._start = time.perf_counter()
        if not self.is_quiet and self._console.is_terminal:
            self._status.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Take the status line away."""
        self._status.stop()

    def update(self, message: str, share: float | None = None) -> None:
        """Show what is being done.

        Args:
            message: What is being done.
            share: How much of the whole run is done, 0 to 1, if that is known.
        """
        if self.is_quiet:
            return
        part = "" if share is None else f" {100 * share:3.0f} %"
        text = f"{time.perf_counter() - self._start:6.1f} s{part}  {message}"
        if self._console.is_terminal:
            self._status.update(text)
        else:
            self._console.print(text, markup=False)

    def say(self, message: str) -> None:
        """Print a message that stays."""
        if not self.is_quiet:
            self._console.print(message, markup=False)
