"""Running the jobs of a campaign on workers, and writing their records."""

import contextlib
import json
import os
import pathlib
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Any

from .._results_folder import netcdf_bytes, write_whole
from ..config import Campaign
from ._dataset import campaign_dataset
from ._task import JobRecord, Task, campaign_tasks, run_task

if TYPE_CHECKING:
    import xarray

# Called with the number of jobs done and of all, and the entry of the last.
OnProgress = Callable[[int, int, str], None]
# Within the folder of results: a file per job.
_JOBS = "jobs"


def run_campaign(
    campaign: Campaign,
    out: str | os.PathLike[str],
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    retry: bool = False,
    on_progress: OnProgress | None = None,
) -> "xarray.Dataset":
    """Run every job of a campaign that has no result yet; return those of all.

    Args:
        campaign: The campaign.
        out: Folder for the results. It keeps a file per job, from which the campaign
            goes on after any interruption, and `result.nc` with all of them.
        workers: Worker processes to start; one per core if None, and 0 to run the jobs
            one after the other in this process, whose JAX is then configured.
        scheduler: Address of a Dask scheduler to use instead, "tcp://host:8786"; its
            workers must see the same folders.
        retry: True to run failed jobs again.
        on_progress: Called whenever a job is done.

    Returns:
        The figures of all jobs, indexed by what varies; also after an interruption by
        `KeyboardInterrupt`, `result.nc` has what there is.

    Raises:
        ImportError: Dask, the extra `campaign`, is not installed.
        OSError: The scheduler does not answer, or the folder cannot be written to.
    """
    folder = pathlib.Path(out)
    jobs = folder / _JOBS
    jobs.mkdir(parents=True, exist_ok=True)
    tasks = campaign_tasks(campaign, jobs.resolve())
    records = _finished_records(tasks, jobs, retry=retry)
    tell = on_progress or (lambda done, count, status: None)
    missing = {t.digest: t for t in tasks if t.digest not in records}
    total = len({task.digest for task in tasks})
    tell(len(records), total, "kept")
    try:
        with _answers(list(missing.values()), workers, scheduler) as answers:
            for task, record in answers:
                records[task.digest] = record
                write_whole(jobs / f"{task.digest}.json", json.dumps(record).encode())
                tell(len(records), total, record["status"])
    finally:
        digests = [task.digest for task in tasks]
        dataset = campaign_dataset(campaign, digests, records)
        write_whole(folder / "result.nc", netcdf_bytes(dataset))
    return dataset


def _finished_records(
    tasks: list[Task], jobs: pathlib.Path, *, retry: bool
) -> dict[str, JobRecord]:
    """Records of jobs that need not run again, by hash."""
    records = {}
    for task in tasks:
        try:
            text = (jobs / f"{task.digest}.json").read_text(encoding="utf-8")
            record = json.loads(text)
        except (OSError, ValueError):
            continue
        has_rows = task.rows_file is None or task.rows_file.exists()
        is_done = record["status"] == "done" and has_rows
        # A worker that was lost says nothing of the job.
        is_final = record["status"] in ("refused", "failed") and not retry
        if is_done or is_final:
            records[task.digest] = record
    return records


@contextlib.contextmanager
def _answers(
    tasks: list[Task], workers: int | None, scheduler: str | None
) -> Iterator[Iterable[tuple[Task, JobRecord]]]:
    """Yield the records of tasks, in the order in which they are done."""
    if not tasks or (workers == 0 and scheduler is None):
        yield ((task, run_task(task)) for task in tasks)
        return
    with _client(min(workers or _cores(), len(tasks)), scheduler) as client:
        yield _from_workers(client, tasks)


def _from_workers(client: Any, tasks: list[Task]) -> Iterator[tuple[Task, JobRecord]]:
    """Yield each task with its record; "lost" where its workers died."""
    from distributed import as_completed

    # The others find in the shared cache what the first one compiles.
    for batch in (tasks[:1], tasks[1:]):
        futures = {
            client.submit(run_task, task, key=f"job-{task.digest}", pure=False): task
            for task in batch
        }
        for future in as_completed(list(futures)):
            task = futures.pop(future)
            if future.status == "finished":
                yield task, future.result()
                continue
            message = f"the job has no answer: {future.exception()}"
            record = JobRecord(status="lost", message=message, figures={}, seconds=0.0)
            yield task, record


def _cores() -> int:
    """Number of cores that this process may use."""
    from dask.system import CPU_COUNT

    return CPU_COUNT


@contextlib.contextmanager
def _client(workers: int, scheduler: str | None) -> Iterator[Any]:
    """Yield a client of a given scheduler, or of workers here that end with it."""
    import logging

    from distributed import Client, LocalCluster

    if scheduler is not None:
        with Client(scheduler, timeout="10s") as client:
            yield client
        return
    with (
        LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            # No limit of Dask's: a compilation takes more memory for a while.
            memory_limit=None,
            dashboard_address=None,  # pyright: ignore[reportArgumentType]
            silence_logs=logging.CRITICAL,
            # Threads that a worker's computation may use.
            env={"NPROC": str(max(1, _cores() // workers))},
        ) as cluster,
        Client(cluster) as client,
    ):
        yield client
