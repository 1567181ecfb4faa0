"""Steps after a run that may fail without harm to its results."""

import contextlib
import pathlib
import sys
import traceback
from collections.abc import Callable, Iterator

from ..._results_folder import ResultsFolder

_ERRORS = "errors.txt"


class Attempts:
    """Attempts at steps that may fail without harm to the results before them."""

    def __init__(self) -> None:
        self._failures: dict[str, Exception] = {}

    @contextlib.contextmanager
    def at(self, step: str) -> Iterator[None]:
        """Try a step; keep the exception that ends it."""
        try:
            yield
        except Exception as error:
            self._failures[step] = error

    def lines(self) -> list[str]:
        """Line for every step that failed."""
        return [
            f"{step} failed: {type(error).__name__}: {str(error).rstrip('.')}"
            for step, error in self._failures.items()
        ]

    def add(self, folder: pathlib.Path, fill: Callable[[pathlib.Path], object]) -> None:
        """Add files to written results, and the tracebacks of failed steps.

        Args:
            folder: The folder of the results.
            fill: Called with a temporary folder, to write any number of files to.
        """

        def fill_all(target: pathlib.Path) -> None:
            fill(target)
            text = [
                f"{step}\n{''.join(traceback.format_exception(error))}"
                for step, error in self._failures.items()
            ]
            if text:
                (target / _ERRORS).write_text("\n".join(text), encoding="utf-8")

        with self.at("writing"):
            ResultsFolder.of(folder).extend(fill_all)

    def conclude(self, folder: pathlib.Path) -> int:
        """Print one message on all steps that failed; return the exit code."""
        if not self._failures:
            return 0
        print(
            f"error: after the run, {'; '.join(self.lines())}. The results in {folder} "
            f"are complete but for that; {_ERRORS} there has the details",
            file=sys.stderr,
        )
        return 1
