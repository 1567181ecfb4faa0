"""Changes of single keys of a job file."""

import copy
import json
from collections.abc import Mapping
from typing import Any

Tables = dict[str, Any]


def changed(
    tables: Tables, changes: Mapping[str, object], problems: list[str]
) -> Tables:
    """Tables of a file with other values at some keys.

    Args:
        tables: The tables.
        changes: Values by key: the names of tables and key with points between, such as
            "spindle.speed"; a number, counted from 1, is an entry of a list.
        problems: Receives a line for every key that leads nowhere.
    """
    found = copy.deepcopy(tables)
    for key, value in changes.items():
        try:
            _put(found, key.split("."), value)
        except LookupError as error:
            problems.append(f"{key}: {error.args[0]}")
    return found


def value_at(tables: Tables, key: str) -> object:
    """Value of a file at a key, written as for `changed`.

    Raises:
        LookupError: It holds nothing there.
    """
    found: Any = tables
    for part in key.split("."):
        if isinstance(found, list):
            found = found[_place(found, part)]
        elif isinstance(found, dict) and part in found:
            found = found[part]
        else:
            cure = ""
            if key.startswith(("robot.joint_stiffness", "robot.joint_damping")):
                cure = "; `diffmill robot MODEL` prints those of a model, to be copied"
            raise LookupError(f"the job file has no value there{cure}")
    return found


def changes_text(changes: Mapping[str, object]) -> str:
    """Changes as comments of a file, for the record in the results."""
    return "".join(
        f"# changed: {key} = {json.dumps(value)}\n" for key, value in changes.items()
    )


def _put(tables: Any, parts: list[str], value: object) -> None:
    """Set a value, with the tables around it where they are absent."""
    for index, part in enumerate(parts):
        is_last = index == len(parts) - 1
        place: Any = part
        if isinstance(tables, list):
            place = _place(tables, part)
        elif not isinstance(tables, dict):
            raise LookupError(f"found {tables!r}, which has no key {part!r}")
        if is_last:
            tables[place] = value
        else:
            tables = (
                tables[place]
                if isinstance(tables, list)
                else tables.setdefault(place, {})
            )


def _place(values: list[Any], part: str) -> int:
    if part.isdecimal() and 1 <= int(part) <= len(values):
        return int(part) - 1
    raise LookupError(
        f"found entry {part!r} of a list; allowed: a number from 1 to {len(values)}"
    )
