"""Reading a campaign: every job that it asks for, as changes of one job file."""

import itertools
import os
import pathlib
from collections.abc import Iterator
from typing import Literal, NamedTuple

from .._toml import JobError, read_toml
from ..settings.tables import validated
from ._campaign.draws import drawn_values, scaled
from ._campaign.schema import CampaignTable, SweepTable
from ._changes import Tables, changed, value_at
from ._schema.job import read_tables


class Variation(NamedTuple):
    """A dimension of a campaign.

    Attributes:
        name: Name of the dimension: the key with underscores, "draw" or "start".
        changes: Of each entry: values by key of the job file.
        factors: By which lists or tables of the job are multiplied, of each entry;
            empty where the values stand for themselves.
    """

    name: str
    changes: tuple[dict[str, object], ...]
    factors: tuple[float, ...] = ()


class Campaign(NamedTuple):
    """Jobs that differ in a few keys.

    Attributes:
        name: Name of the campaign, for file names.
        source: Text of its file.
        job: The job file that all start from.
        tables: What that file holds.
        command: What is done with each job.
        keeps_rows: Whether each job's own result is kept, too.
        variations: What varies: a job for every combination of their entries.
        allow_outside: Whether the job may name files outside its own folder.
    """

    name: str
    source: str
    job: pathlib.Path
    tables: Tables
    command: Literal["simulate", "correct"]
    keeps_rows: bool
    variations: tuple[Variation, ...]
    allow_outside: bool

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of entries of each variation."""
        return tuple(len(variation.changes) for variation in self.variations)

    def changes(self) -> Iterator[dict[str, object]]:
        """Changes of every job; the last variation changes fastest."""
        for entries in itertools.product(*(v.changes for v in self.variations)):
            yield {key: value for entry in entries for key, value in entry.items()}

    def changed(self, changes: dict[str, object]) -> Tables:
        """Tables of the job file with other values at some keys."""
        return changed(self.tables, changes, [])


def load_campaign(
    file: str | os.PathLike[str], *, allow_outside: bool = False
) -> Campaign:
    """Campaign of a TOML file and the job that it names.

    Args:
        file: The campaign's file.
        allow_outside: Whether the campaign may name a job outside its own folder, and
            the job files outside of its own.

    Raises:
        JobError: If anything is wrong with the file, or a value is none that the job
            may hold at its key. All is listed at once. What depends on more than one
            key is found when the job runs.
    """
    path = pathlib.Path(file)
    text, raw = read_toml(path)
    problems: list[str] = []
    table = validated(CampaignTable, raw, "campaign:", problems)
    if table is None:
        raise JobError(path, problems)
    job = path.parent / table.job
    if not (allow_outside or job.resolve().is_relative_to(path.parent.resolve())):
        problems.append(
            f"job: found {table.job!r}, which leads outside the campaign's folder; "
            "allowed are files in it or below (--allow-outside permits others)"
        )
        raise JobError(path, problems)
    tables = read_toml(job).tables
    _check_keys(table, problems)
    variations = [_swept(entry, tables, problems) for entry in table.sweep]
    if table.draws and table.draw:
        variations.append(_drawn(table, tables, problems))
    if table.starts is not None:
        variations.append(_starts(table))
    _check_values(tables, variations, problems)
    if problems:
        raise JobError(path, problems)
    return Campaign(
        path.stem,
        text,
        job,
        tables,
        table.command,
        table.keep_rows,
        tuple(variations),
        allow_outside,
    )


def _check_keys(table: CampaignTable, problems: list[str]) -> None:
    """Faults of keys that vary twice, and of tables without their counterpart."""
    keys = [entry.key for entry in (*table.sweep, *table.draw)]
    if table.starts is not None:
        keys += ["correction.start_spread", "correction.start_seed"]
        if table.command != "correct":
            problems.append(
                '[starts]: found beside command = "simulate"; allowed with '
                'command = "correct", which an optimiser has a start in'
            )
    for one, other in itertools.combinations(keys, 2):
        if f"{one}.".startswith(f"{other}.") or f"{other}.".startswith(f"{one}."):
            problems.append(f"{one}: found beside {other}, but a key may vary once")
    if bool(table.draws) != bool(table.draw):
        problems.append(
            f"draws: found {table.draws} beside {len(table.draw)} tables [[draw]], but "
            "both or none are required"
        )


def _swept(entry: SweepTable, tables: Tables, problems: list[str]) -> Variation:
    """Variation of a key: its values, or the job's value times factors."""
    values, factors = entry.values or [], ()
    if (entry.values is None) == (entry.factors is None):
        problems.append(
            f"[[sweep]] {entry.key}: one of values and factors is required, such as "
            'values = ["7000 rpm", "8000 rpm"] or factors = [0.5, 1, 2]'
        )
    elif entry.factors is not None:
        try:
            held = value_at(tables, entry.key)
            values = [scaled(held, factor, entry.key) for factor in entry.factors]
            factors = tuple(entry.factors) if isinstance(held, list | dict) else ()
        except (LookupError, ValueError) as error:
            problems.append(f"[[sweep]] {entry.key}: factors: {error.args[0]}")
    changes = tuple({entry.key: value} for value in values)
    dimension = entry.key.replace(".", "_").replace("-", "_")
    return Variation(dimension, changes, factors)


def _starts(table: CampaignTable) -> Variation:
    """Variation of the optimiser's start; the first is that of the job alone."""
    assert table.starts is not None
    return Variation(
        "start",
        tuple(
            {
                "correction.start_spread": f"{table.starts.spread * bool(seed)!r} m",
                "correction.start_seed": seed,
            }
            for seed in range(table.starts.count)
        ),
    )


def _drawn(table: CampaignTable, tables: Tables, problems: list[str]) -> Variation:
    """Variation of all keys that scatter, a draw an entry."""
    columns: dict[str, list[object]] = {}
    for entry in table.draw:
        try:
            columns[entry.key] = drawn_values(entry, table, tables)
        except (LookupError, ValueError) as error:
            problems.append(f"[[draw]] {entry.key}: {error.args[0]}")
    return Variation(
        "draw",
        tuple(
            {key: values[number] for key, values in columns.items()}
            for number in range(table.draws)
        ),
    )


def _check_values(
    tables: Tables, variations: list[Variation], problems: list[str]
) -> None:
    """Faults of values that the job may not hold at their keys."""
    known: list[str] = []
    read_tables(tables, known)
    for variation in variations:
        for changes in variation.changes:
            found: list[str] = []
            read_tables(changed(tables, changes, found), found)
            problems.extend(p for p in found if p not in (*known, *problems))
