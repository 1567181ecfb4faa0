"""Running a campaign: its plan, its progress, its results."""

import importlib.util
import pathlib
from typing import TYPE_CHECKING, NamedTuple

from .._results_folder import PART, ResultsFolder, remove_parts
from ._session.errors import BadInput, bad_input, interruption_leaves, locked_folder
from ._session.progress import Progress

if TYPE_CHECKING:
    import xarray

    from ..config import Campaign

# Lines about jobs that failed, at most.
_MOST_LINES = 5


class Workers(NamedTuple):
    """Processes that run the jobs.

    Attributes:
        processes: Worker processes to start; None for one per core.
        scheduler: Address of a Dask scheduler to use instead, or None.
        retry: True to run failed jobs again.
    """

    processes: int | None
    scheduler: str | None
    retry: bool


def run_campaign_file(
    file: pathlib.Path,
    workers: Workers,
    out: pathlib.Path | None,
    *,
    force: bool,
    progress: Progress,
    allow_outside: bool,
) -> int:
    """Load and run a campaign; return the exit code.

    Args:
        file: The campaign's file.
        workers: The processes that run its jobs.
        out: Folder for the results, or None for `./<file>-campaign`.
        force: True to run every job anew.
        progress: Shows how far it is.
        allow_outside: True if files outside their folders may be named.
    """
    from ..campaign import run_campaign
    from ..config import load_campaign

    folder = pathlib.Path(f"{file.stem}-campaign") if out is None else out
    if workers.processes is not None and workers.processes < 0:
        raise BadInput(f"--workers: found {workers.processes}; at least 0 is required")
    with bad_input():
        campaign = load_campaign(file, allow_outside=allow_outside)
        _check_folder(folder)
    has_dask = importlib.util.find_spec("distributed") is not None
    if workers.processes is None and workers.scheduler is None and not has_dask:
        workers = workers._replace(processes=0)
        progress.write(
            "note: the jobs run one after the other: with Dask, the extra `campaign` "
            "of diffmill, each core gets a worker (docs/campaign.md)"
        )

    def tell(done: int, count: int, status: str) -> None:
        progress.update(f"{done} of {count} jobs have a result", done / count)

    remains = (
        f"{folder} keeps the jobs that are done: the same command goes on from there"
    )
    jobs = folder / "jobs"
    try:
        with (
            locked_folder(jobs) as unlocked,
            interruption_leaves(lambda: remains),
            progress,
        ):
            if unlocked:
                progress.write(f"note: {unlocked}")
            else:
                # Parts of workers and of the dataset have no lock of their own.
                remove_parts(jobs)
                remove_parts(folder, but=ResultsFolder.of(jobs).lock)
            if force:
                for record in jobs.glob("*.json"):
                    record.unlink()
            dataset = run_campaign(
                campaign,
                folder,
                workers=workers.processes,
                scheduler=workers.scheduler,
                retry=workers.retry,
                on_progress=tell,
            )
    except ImportError as error:
        raise BadInput(
            f"campaign: {error}; Dask is the extra `campaign` of diffmill, "
            "--workers 0 does without it"
        ) from error
    for line in _lines(campaign, dataset, folder):
        progress.answer(line)
    return int(dataset.attrs["incomplete"])


def _check_folder(folder: pathlib.Path) -> None:
    """Refuse a folder of something else."""
    if folder.is_file():
        raise BadInput(f"--out {folder}: found a file; a folder is required")
    is_ours = (folder / "jobs").is_dir()
    is_other = lambda file: not file.name.startswith(PART)
    if folder.is_dir() and any(map(is_other, folder.iterdir())) and not is_ours:
        raise BadInput(
            f"--out {folder}: found a folder that is not empty; that of a campaign, an "
            "empty or a new one is required"
        )


def _place_of_least(campaign: "Campaign", values: "xarray.DataArray") -> str:
    """Place of the least value in the grid, in the words of the file."""
    if not values.dims or not values.notnull().any():
        return ""
    least = {str(name): int(at) for name, at in values.argmin([*values.dims]).items()}
    named = []
    for variation in campaign.variations:
        at = least[variation.name]
        changes = variation.changes[at]
        if variation.factors:
            named.append(f"{variation.factors[at]:g} times {next(iter(changes))}")
            continue
        named += [
            f"{key} = {value}"
            if key.replace(".", "_") == variation.name
            else f"{variation.name} {least[variation.name]}"
            for key, value in [*changes.items()][:1]
        ]
    return f", the least at {', '.join(named)}"


def _lines(
    campaign: "Campaign", dataset: "xarray.Dataset", folder: pathlib.Path
) -> list[str]:
    """Lines on the counts of jobs, the range of the error and the failures."""
    states = dataset.status.attrs["flag_meanings"].split()
    status = dataset.status.values.ravel()
    counts = [f"{(status == i).sum()} {name}" for i, name in enumerate(states)]
    counts = [text for text in counts if not text.startswith("0 ")]
    sizes = ", ".join(f"{name} {size}" for name, size in dataset.status.sizes.items())
    lines = [f"{campaign.name}: {status.size} jobs ({sizes}): {', '.join(counts)}"]
    if "error_rms" in dataset:
        error = dataset.error_rms
        for case in dataset["case"].values if "case" in error.dims else [None]:
            values = (error if case is None else error.sel(case=case)) * 1e6
            name = "" if case is None else f", {case}"
            lines.append(
                f"contour error rms{name}: {float(values.min()):.2f} to "
                f"{float(values.max()):.2f} um{_place_of_least(campaign, values)}"
            )
        for name, size in error.sizes.items():
            is_same = bool((error == error.isel({name: 0})).all())
            if name != "case" and size > 1 and is_same:
                lines.append(
                    f"note: {name} changes nothing, every value gives the same error: "
                    "`diffmill check` of the job may say why, as of a feed where the "
                    "program has its own"
                )
    failed = [str(text) for text in dataset.message.values.ravel() if text]
    for text in list(dict.fromkeys(failed))[:_MOST_LINES]:
        lines.append(f"{failed.count(text)} of them: {text[:300]}")
    return [*lines, f"results: {folder / 'result.nc'}"]
