"""One job of a campaign: the task of a worker, and its record."""

import gc
import hashlib
import json
import pathlib
import time
from importlib import metadata
from typing import Literal, NamedTuple, TypedDict

from .._jax_config import configure_jax
from .._results_folder import netcdf_bytes, write_whole
from .._toml import JobError
from ..config import Campaign, job_precision, load_job
from ..io import PROGRAM_FORMATS


class JobRecord(TypedDict):
    """Record of a job, as JSON.

    `status` is "done", "failed", "refused" or "lost", in a dataset also "missing", and
    `message` the reason; `figures` are in SI, of each case by name; `seconds` is the
    time of the run.
    """

    status: str
    message: str
    figures: dict[str, dict[str, float]]
    seconds: float


# Memory mappings from which on compiled programs are dropped. Each takes some tens, and
# Linux allows a process 65,530: one more ends it in the compiler.
_MOST_MAPPINGS = 30_000
# Suffixes of subprograms, modules and data that a program reads from its folder.
_PARTS = {*PROGRAM_FORMATS, ".dat", ".sys"} - {".csv"}
# Size of these up to which contents are hashed; sizes and times stand for more [bytes].
_MOST_BYTES = 1_000_000_000


class Task(NamedTuple):
    """A job of a campaign.

    Attributes:
        file: The job file.
        changes: Values of the keys that vary.
        command: Command that runs it.
        allow_outside: True if the job may name files outside its own folder.
        digest: Hash of the text of the job and of its files.
        rows_file: File of its own result; None to keep only figures.
    """

    file: pathlib.Path
    changes: dict[str, object]
    command: Literal["simulate", "correct"]
    allow_outside: bool
    digest: str
    rows_file: pathlib.Path | None


def campaign_tasks(campaign: Campaign, folder: pathlib.Path) -> list[Task]:
    """Return every job of a campaign, in the order of its variations.

    Args:
        campaign: The campaign.
        folder: Folder of the results of jobs.
    """
    known: dict[pathlib.Path, str] = {}
    tasks = []
    for changes in campaign.changes():
        digest = _digest(campaign, changes, known)
        rows = folder / f"{digest}.nc" if campaign.keeps_rows else None
        tasks.append(
            Task(
                campaign.job.resolve(),
                changes,
                campaign.command,
                campaign.allow_outside,
                digest,
                rows,
            )
        )
    return tasks


def _digest(
    campaign: Campaign, changes: dict[str, object], known: dict[pathlib.Path, str]
) -> str:
    """Return a hash of a job's text, of the files that it names, and of the version."""
    tables, folder = campaign.changed(changes), campaign.job.parent
    contents = {name: _content(folder / name, known) for name in _texts(tables)}
    for name in _texts(tables.get("program", {})):
        if pathlib.PurePath(name).suffix.lower() in _PARTS:
            contents[f"beside {name}"] = _folder_digest((folder / name).parent, known)
    content = {
        "command": campaign.command,
        "tables": tables,
        "files": {name: digest for name, digest in contents.items() if digest},
        "version": metadata.version("diffmill"),
    }
    text = json.dumps(content, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _texts(value: object) -> list[str]:
    """Return every text in tables."""
    if isinstance(value, str):
        return [value]
    inner = value.values() if isinstance(value, dict) else value
    if not isinstance(value, dict | list):
        return []
    return [text for one in inner for text in _texts(one)]  # pyright: ignore


def _content(path: pathlib.Path, known: dict[pathlib.Path, str]) -> str:
    """Hash of a file, or of the result's stock in a folder; else an empty text."""
    if path not in known:
        known[path] = ""
        try:
            file = path / "stock.npz" if path.is_dir() else path
            if file.is_file():
                known[path] = hashlib.sha256(file.read_bytes()).hexdigest()
        except (OSError, ValueError):
            # The text is no name of a file, but a quantity or a choice.
            pass
    return known[path]


def _folder_digest(folder: pathlib.Path, known: dict[pathlib.Path, str]) -> str:
    """Hash of all files that a program may read from its own folder."""
    key = folder / "*"
    if key not in known:
        # As the readers, it follows no link out of the folder.
        files = [
            one
            for one in (sorted(folder.iterdir()) if folder.is_dir() else ())
            if one.suffix.lower() in _PARTS
            and one.is_file()
            and one.resolve().parent == folder.resolve()
        ]
        stats = [one.stat() for one in files]
        if sum(stat.st_size for stat in stats) <= _MOST_BYTES:
            marks = [_content(one, known) for one in files]
        else:
            marks = [f"{stat.st_size} {stat.st_mtime_ns}" for stat in stats]
        names = [one.name for one in files]
        text = json.dumps(list(zip(names, marks, strict=True)))
        known[key] = hashlib.sha256(text.encode()).hexdigest()
    return known[key]


def run_task(task: Task) -> JobRecord:
    """Load and run a job; return its figures, or the reason why there are none."""
    configure_jax(job_precision(task.file, task.changes))
    start = time.perf_counter()
    status, message, figures = "done", "", {}
    try:
        figures = _figures(task)
    except JobError as error:
        status, message = "refused", "; ".join(error.problems)
    except (OSError, MemoryError) as error:
        # A full disk or memory is no fault of the job.
        status, message = "lost", f"{type(error).__name__}: {error}"
    except Exception as error:
        status, message = "failed", f"{type(error).__name__}: {error}"
    _drop_programs()
    seconds = time.perf_counter() - start
    return JobRecord(status=status, message=message, figures=figures, seconds=seconds)


def _figures(task: Task) -> dict[str, dict[str, float]]:
    """Figures of a job by case, in SI."""
    from ..correction import correct
    from ..io import described
    from ..sim import simulate
    from ..viz import case_numbers

    job = load_job(task.file, changes=task.changes, allow_outside=task.allow_outside)
    run = simulate if task.command == "simulate" else correct
    dataset = run(job).to_dataset()
    if task.rows_file is not None:
        named = described(dataset.assign_attrs(job=job.name, source=job.source))
        write_whole(task.rows_file, netcdf_bytes(named))
    cases = dataset["case"].values if "case" in dataset.dims else ["predicted"]
    figures = {}
    for index, case in enumerate(str(name) for name in cases):
        numbers = case_numbers(dataset, case)
        figures[case] = {
            "error_rms": numbers.contour.rms,
            "error_p95": numbers.contour.p95,
            "error_max": numbers.contour.max,
            "force_mean": numbers.force_mean,
            "force_max": numbers.force_maximum,
            "removed_volume": numbers.removed_volume,
            "program_time": float(dataset["time"][-1]),
        }
        if "max_acceleration" in dataset:
            figures[case]["max_acceleration"] = float(dataset.max_acceleration[index])
    return figures


def _drop_programs() -> None:
    """Drop compiled programs where a process holds many."""
    import jax

    maps = pathlib.Path("/proc/self/maps")
    if maps.is_file() and maps.read_bytes().count(b"\n") > _MOST_MAPPINGS:
        jax.clear_caches()
        gc.collect()
