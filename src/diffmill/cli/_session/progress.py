"""Showing how far a run is."""

import time
from types import TracebackType

from rich.console import Console

# Compiling what is shorter is not worth a line [s].
_LEAST_COMPILATION = 0.2


class Progress:
    """A status line on a terminal; one line per message where there is none.

    Attributes:
        is_quiet: Whether nothing is shown.
        is_verbose: Whether every message stays, and what is compiled is named.
    """

    def __init__(self, *, is_quiet: bool = False, is_verbose: bool = False):
        self.is_quiet = is_quiet
        self.is_verbose = is_verbose
        # Results of a pipe go to stdout, so that progress must not.
        self._console = Console(stderr=True, highlight=False, soft_wrap=True)
        self._status = self._console.status("starting")
        self._start = time.perf_counter()
        self._has_begun = False

    def __enter__(self) -> "Progress":
        """Show the status line."""
        self._start = time.perf_counter()
        if self.is_verbose:
            import jax

            if not self._has_begun:
                self.say(_versions())
            jax.monitoring.register_event_duration_secs_listener(self._compiled)
        self._has_begun = True
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
        if self.is_verbose:
            import jax

            jax.monitoring.unregister_event_duration_listener(self._compiled)

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
        if self.is_verbose or not self._console.is_terminal:
            self._console.print(text, markup=False)

    def say(self, message: str) -> None:
        """Print a message that stays."""
        if not self.is_quiet:
            self._console.print(message, markup=False)

    def _compiled(self, event: str, duration_secs: float, **kwargs: str | int) -> None:
        """Name a program that XLA has compiled, or that was found compiled."""
        name = kwargs.get("fun_name")
        if (
            event.endswith("/backend_compile_duration")
            and duration_secs > _LEAST_COMPILATION
        ):
            self.update(
                f"compiled, or read from the cache: {name} ({duration_secs:.1f} s)"
            )


def _versions() -> str:
    """Return what computes, in one line."""
    from importlib import metadata

    import jax

    devices = ", ".join(str(x) for x in jax.devices())
    packages = " ".join(f"{x} {metadata.version(x)}" for x in ("diffmill", "jax"))
    cache = jax.config.jax_compilation_cache_dir or "none"  # pyright: ignore[reportAttributeAccessIssue]
    return f"{packages} on {devices}; compiled programs: {cache}"
