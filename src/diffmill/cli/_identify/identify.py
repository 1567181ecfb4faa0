"""`diffmill identify`: read, fit, tell, and write a folder of what was found."""

import json
import math
import pathlib
import time
from typing import Any

from .._session.errors import BadInput, bad_input
from .._session.jax_config import configure_jax
from .._session.progress import Progress
from .outcome import Outcome


def run_identify(
    file: pathlib.Path,
    forces: pathlib.Path | None,
    out: pathlib.Path | None,
    *,
    force: bool,
    is_quiet: bool,
    allow_outside: bool,
) -> int:
    """Identify what a file asks for and write the results; return the exit code.

    Args:
        file: A file with `kind`, or a job beside `forces`.
        forces: A record of forces of the job, or None.
        out: Folder for the results, or None for `./<file>-identify`.
        force: Whether results that are there are replaced.
        is_quiet: Whether only errors are printed.
        allow_outside: Whether the file may name files outside its folder.
    """
    configure_jax(None)
    from ..._result import SimulationFailed
    from ...config import load_identification, snippet
    from ...io import check_folder, write_folder

    folder = pathlib.Path(f"{file.stem}-identify") if out is None else out
    start = time.perf_counter()
    with bad_input():
        check_folder(folder, force=force)
        task = load_identification(file, forces, allow_outside=allow_outside)
    progress = Progress(is_quiet=is_quiet)
    try:
        with progress:
            outcome = _identified(task, progress)
            progress.update("figures")
    except SimulationFailed as failure:
        raise BadInput(f"{file}: the cut could not be simulated: {failure}") from None

    def fill(target: pathlib.Path) -> None:
        head = [f"identified from {file.name} by diffmill", "paste into a job file"]
        text = snippet(head, outcome.toml)
        (target / "identified.toml").write_text(text, encoding="utf-8")
        (target / "summary.txt").write_text(
            "\n".join(outcome.lines) + "\n", encoding="utf-8"
        )
        facts = json.dumps(_plain(outcome.facts), indent=2, allow_nan=False)
        (target / "identified.json").write_text(facts + "\n", encoding="utf-8")
        outcome.draw(target)

    with progress:
        write_folder(folder, fill, force=force)
    if not is_quiet:
        print("\n".join([*outcome.lines, "", *outcome.toml]))
    progress.say(f"results: {folder} ({time.perf_counter() - start:.1f} s)")
    return 0


def _identified(task: Any, progress: Progress) -> Outcome:
    """Fit what the task asks for."""
    from ...config import CoupledTask, ForceRecordTask, LoadTestTask, MeanForceTask

    if isinstance(task, CoupledTask):
        from .coupled import identify_coupled

        return identify_coupled(task, progress)
    if isinstance(task, MeanForceTask):
        from .mean_forces import identify_means

        return identify_means(task, progress)
    if isinstance(task, ForceRecordTask):
        from .force_records import identify_records

        return identify_records(task, progress)
    if isinstance(task, LoadTestTask):
        from .stiffness import identify_stiffness

        return identify_stiffness(task, progress)
    from .modal import identify_modes

    return identify_modes(task, progress)


def _plain(value: Any) -> Any:
    """Return facts as JSON can hold them: numbers that are none become None."""
    if isinstance(value, dict):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
