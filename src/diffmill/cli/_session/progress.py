"""Display of the progress of a run."""

import statistics
import threading
import time
from types import TracebackType

from rich.console import Console

from ..._messages import printable
from .._expected import spelled

# A shorter compilation gets no line [s].
_LEAST_COMPILATION = 0.2
# In a log a stage that has no line yet, or compiles, gets one after this time [s].
_LONGEST_SILENCE = 8.0
# In a log a stage that goes on says so again after this time [s].
_SIGN_OF_LIFE = 60.0
# Steps of a run, by the latest of which the time left is told; the first one compiles.
_LATEST, _LEAST_STEPS = 5, 2
_COMPILE_EVENT = "/backend_compile_duration"


class Progress:
    """A status line on a terminal; one line per stage where there is none.

    Attributes:
        is_quiet: True to show nothing.
        is_verbose: True to keep every message, and to name compiled programs.
        prints_json: True if the standard output is for JSON alone.
    """

    def __init__(
        self,
        *,
        is_quiet: bool = False,
        is_verbose: bool = False,
        prints_json: bool = False,
    ):
        self.is_quiet = is_quiet
        self.is_verbose = is_verbose
        self.prints_json = prints_json
        # Results of a pipe go to stdout, so that progress must not.
        self._console = Console(stderr=True, highlight=False, soft_wrap=True)
        self._status = self._console.status("starting")
        self._start = time.perf_counter()
        self._has_begun = False
        # Share done, and when; time for all of the run, at the pace of each step [s].
        self._done, self._paces = (0.0, self._start), list[float]()
        self._message, self._compiling, self._said = "starting", 0, 0.0
        self._stage = ""
        self._named = set[str]()
        self._is_over = threading.Event()

    def __enter__(self) -> "Progress":
        """Show the status line."""
        import jax

        self._said = time.perf_counter()
        if not self._has_begun:
            self._start = self._said
        self._done, self._paces = (0.0, self._said), []
        if self.is_verbose and not self._has_begun:
            self.write(_versions())
        jax.monitoring.register_scalar_listener(self._compiles)
        jax.monitoring.register_event_duration_secs_listener(self._compiled)
        self._has_begun = True
        self._message, self._compiling = "starting", 0
        self._named.clear()
        if not self.is_quiet:
            if self._console.is_terminal:
                self._status.start()
            self._is_over = threading.Event()
            threading.Thread(target=self._refresh, daemon=True).start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Take the status line away."""
        import jax

        self._is_over.set()
        self._status.stop()
        jax.monitoring.unregister_scalar_listener(self._compiles)
        jax.monitoring.unregister_event_duration_listener(self._compiled)

    def update(
        self, message: str, share: float | None = None, then: str | None = None
    ) -> None:
        """Show the present step.

        Args:
            message: The present step.
            share: Share of the whole run that is done, 0 to 1, if that is known.
            then: The next step, if the message is of a step that is done.
        """
        if self.is_quiet:
            return
        part, left = "", ""
        if share is not None:
            part, left = f"{100 * share:3.0f} %  ", self._remaining_time(share)
        self._show(f"{part}{message}{left}", stays=self.is_verbose)
        self._message = f"{part}{then or message}"
        self._named.add(self._message)

    def _remaining_time(self, share: float) -> str:
        """Words on the time left at the pace of the latest steps; none at the ends."""
        now, (before, then) = time.perf_counter(), self._done
        if share <= before:
            return ""
        self._done = share, now
        self._paces = [*self._paces, (now - then) / (share - before)][-_LATEST:]
        if len(self._paces) < _LEAST_STEPS or share >= 1:
            return ""
        left = (1 - share) * statistics.median_low(self._paces)
        return f", about {spelled(left)} left"

    def within(self, message: str, share: float) -> None:
        """Show how far the present step is; a log that was not silent long does not.

        Args:
            message: The present step.
            share: Share of it that is done, 0 to 1.
        """
        if self.is_quiet:
            return
        if message != self._stage:
            self._stage, self._paces, self._done = message, [], (0.0, self._said)
        left = self._remaining_time(share)
        self._message = f"{100 * share:3.0f} %  {message}{left}"
        # What comes next has no share: one line of a log is enough for both.
        self._named.add(self._message)
        is_due = time.perf_counter() - self._said > _LONGEST_SILENCE
        if self._console.is_terminal or is_due:
            self._show(self._message, stays=self.is_verbose)

    def stage(self, message: str, share: float) -> None:
        """Show how far a stage is: a line as it begins, and then as `within`.

        Args:
            message: The stage.
            share: Share of it that is done, 0 to 1.
        """
        if share == 0:
            self.update(message)
        else:
            self.within(message, share)

    def begin(self, message: str) -> None:
        """Set the present step, which is shown if it takes long."""
        self._message = message
        self._status.update(message)

    def write(self, message: str) -> None:
        """Print a message that stays."""
        if not self.is_quiet:
            self._console.print(printable(message), markup=False)

    def answer(self, message: str) -> None:
        """Print a result: on the standard output, if that is not for JSON."""
        if self.prints_json or self.is_quiet:
            self.write(message)
        else:
            print(printable(message), flush=True)

    def _show(self, message: str, *, stays: bool) -> None:
        """Show a line with the time; on a terminal it may stay."""
        text = f"{time.perf_counter() - self._start:6.1f} s  {printable(message)}"
        self._said = time.perf_counter()
        if self._console.is_terminal:
            self._status.update(text)
        if stays or not self._console.is_terminal:
            self._console.print(text, markup=False)

    def _refresh(self) -> None:
        """Show the present step: every second on a terminal, seldom in a log."""
        is_terminal = self._console.is_terminal
        every = 1.0 if is_terminal else _LONGEST_SILENCE
        while not self._is_over.wait(0.2 * every):
            what = ": compiling, once for jobs of this kind" if self._compiling else ""
            text = self._message + what
            silence = time.perf_counter() - self._said
            is_new = is_terminal or text not in self._named
            if silence > (every if is_new else _SIGN_OF_LIFE):
                self._named.add(text)
                self._show(text, stays=False)

    def _compiles(self, event: str, value: float | int, **kwargs: str | int) -> None:
        """Note that XLA begins to compile a program."""
        self._compiling += event.endswith(_COMPILE_EVENT)

    def _compiled(self, event: str, duration_secs: float, **kwargs: str | int) -> None:
        """Note that a program is compiled, or read; name it if the run is verbose."""
        if not event.endswith(_COMPILE_EVENT):
            return
        self._compiling = max(self._compiling - 1, 0)
        if self.is_verbose and duration_secs > _LEAST_COMPILATION:
            name = kwargs.get("fun_name")
            self._show(
                f"compiled, or read from the cache: {name} ({duration_secs:.1f} s)",
                stays=True,
            )


def _versions() -> str:
    """Versions, devices and folder of compiled programs, in one line."""
    from importlib import metadata

    import jax

    devices = ", ".join(str(x) for x in jax.devices())
    packages = " ".join(f"{x} {metadata.version(x)}" for x in ("diffmill", "jax"))
    cache = jax.config.jax_compilation_cache_dir or "none"  # pyright: ignore[reportAttributeAccessIssue]
    return f"{packages} on {devices}; compiled programs: {cache}"
