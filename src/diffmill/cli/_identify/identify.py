"""`diffmill identify`: read, fit, report, and write a folder of results."""

import importlib
import json
import math
import pathlib
import time
from typing import TYPE_CHECKING, Any, Protocol, cast, runtime_checkable

from ..._jax_config import configure_jax
from ..._messages import printable
from ..._results_folder import ResultsFolder
from .._session.attempts import Attempts
from .._session.errors import (
    BadInput,
    bad_input,
    interruption_leaves,
    locked_folder,
)
from .._session.progress import Progress
from .report import Report, estimate_table

if TYPE_CHECKING:
    from ...identification import Study
    from ...viz import StudyReport, Verdict

# Captions of figures by how their names begin.
_CAPTIONS = {
    "correlation": "Two values whose errors correlate by nearly 1 or -1 are hard to "
    "distinguish with these measurements.",
    "damping_correlation": "Two dampers whose errors correlate by nearly 1 or -1 are "
    "hard to distinguish with these measurements.",
    "left_out": "Measurements that the fit did not see, as the fit predicts them.",
    "prediction": "Measurements that the fit did not see, as the fit predicts them.",
    "record": "What was measured, and what the fit makes of it.",
    "spectrum": "What the fit leaves, over the frequency.",
    "mean_forces": "Mean forces over the feed with their lines, and what these leave.",
    "stiffness": "Fitted springs with two standard errors beside those of the model.",
    "residual": "Size of each displacement, and what the fit leaves of it.",
    "controller": "Actual less commanded path, measured and by the controller found.",
    "ring_down": "The vibration, its fit and what that leaves.",
    "frequency_response": "Size and phase of the response, measured and fitted.",
    "damping": "Fitted dampers with two standard errors beside those of the model.",
    "reversal": "Link less motor over the position, measured and as other records "
    "predict it.",
    "force": "What was measured, and what the fit makes of it.",
    "deviation": "What was measured, and what the fit makes of it.",
}


def run_identify(
    file: pathlib.Path,
    forces: pathlib.Path | None,
    out: pathlib.Path | None,
    *,
    force: bool,
    progress: Progress,
    allow_outside: bool,
) -> int:
    """Identify what a file asks for and write the results; return the exit code.

    Args:
        file: A file with `kind`, or a job beside `forces`.
        forces: A record of forces of the job, or None.
        out: Folder for the results, or None for `./<file>-identify`.
        force: Whether results that are there are replaced.
        progress: Shows how far it is.
        allow_outside: Whether the file may name files outside its folder.
    """
    folder = pathlib.Path(f"{file.stem}-identify") if out is None else out
    with bad_input():
        ResultsFolder.of(folder).check(force=force)
    # What takes seconds to import waits until it is needed.
    configure_jax()
    from ...config import load_identification

    start = time.perf_counter()
    with bad_input(), progress:
        progress.begin("reading the measurements")
        study = load_identification(file, forces, allow_outside=allow_outside)
    with locked_folder(folder) as unlocked:
        if unlocked:
            progress.write(f"note: {unlocked}")
        return _identify(file, study, folder, progress, force=force, start=start)


def _identify(
    file: pathlib.Path,
    study: "Study",
    folder: pathlib.Path,
    progress: Progress,
    *,
    force: bool,
    start: float,
) -> int:
    """Fit what a study asks for, and write it; return the exit code."""
    from ..._result import SimulationFailed
    from ...identification import StudyError
    from ...viz import save_figure
    from .toml_snippets import snippet

    try:
        with progress:
            words = in_words(study)
            report = words.report(study, study.run(progress.update))
    except StudyError as error:
        raise BadInput(str(error)) from error
    except SimulationFailed as failure:
        raise BadInput(f"{file}: the cut could not be simulated: {failure}") from None

    def fill(target: pathlib.Path) -> None:
        head = [f"identified from {file.name} by diffmill", "paste into a job file"]
        text = snippet(head, report.toml)
        (target / "identified.toml").write_text(text, encoding="utf-8")
        (target / "summary.txt").write_text(report.text + "\n", encoding="utf-8")
        facts = json.dumps(_plain(report.facts), indent=2, allow_nan=False)
        (target / "identified.json").write_text(facts + "\n", encoding="utf-8")

    # Whatever fails from here on, what was found is kept and shown.
    if not progress.is_quiet:
        print(printable("\n".join([report.text, "", *report.toml])))
    folder = ResultsFolder.of(folder).still_free(force=force)
    ResultsFolder.of(folder).write(fill, force=force)
    attempts = Attempts()

    def draw(target: pathlib.Path) -> None:
        drawn = []
        for name, figure in report.figures.items():
            with attempts.at(f"figure {name}"):
                save_figure(figure(), target / f"{name}.png")
                drawn.append(name)
        with attempts.at("report"):
            asked = [line.strip() for line in words.reading(study)]
            _page(file, study.kind, asked, report).write(target, drawn)

    left = f"{folder} has the results without all figures"
    with progress, interruption_leaves(lambda: left):
        progress.update("figures")
        attempts.add(folder, draw)
    progress.write(f"results: {folder} ({time.perf_counter() - start:.1f} s)")
    return attempts.conclude(folder)


def _page(
    file: pathlib.Path, kind: str, asked: list[str], report: Report
) -> "StudyReport":
    """Report of an identification as a page."""
    from ...viz import StudyReport

    return StudyReport(
        kind="Identification",
        title=f"{file.stem}: {kind.replace('_', ' ')}",
        asked=(
            f"Values that {file.name} names, from these measurements:",
            # Notes have their own section.
            *(line for line in asked if not line.startswith("note: ")),
        ),
        verdict=_verdict(report),
        tables=(estimate_table(report.estimates),),
        assumptions=tuple(report.assumptions),
        warnings=tuple(report.marked("warning")),
        notes=tuple(report.marked("note")),
        text="\n".join([report.text, "", *report.toml]),
        source=file.read_text(encoding="utf-8", errors="replace"),
        captions=_CAPTIONS,
    )


def _verdict(report: Report) -> "Verdict":
    """Verdict on the use of the values."""
    from ...viz import Verdict

    known = sum(one.is_known for one in report.estimates)
    count = f"{known} of {len(report.estimates)} values are identifiable"
    written = [line for line in report.toml if line]
    if all(line.startswith("#") for line in written):
        why = written[0].lstrip("# ") if written else "Nothing was found."
        return Verdict(False, "Not to be used", f"{count}. {why}")
    if report.marked("warning"):
        return Verdict(False, "Doubtful", f"{count}, but see the warnings.")
    return Verdict(True, "Found", f"{count}; identified.toml has them for a job.")


@runtime_checkable
class KindInWords(Protocol):
    """Module of this room with the name of a kind of identification."""

    def report(self, study: "Study", result: object, /) -> Report:
        """Report of a fit.

        Args:
            study: The study.
            result: Result of its `run`.
        """
        ...

    def reading(self, study: "Study", /) -> list[str]:
        """Measurements of a study in words, line by line."""
        ...


def in_words(study: "Study") -> KindInWords:
    """Module that reports a study: the one of its kind."""
    module = importlib.import_module(f".{study.kind}", __package__)
    return cast(KindInWords, module)


def _plain(value: Any) -> Any:
    """Facts as JSON can hold them: numbers that are not finite become None."""
    if isinstance(value, dict):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
