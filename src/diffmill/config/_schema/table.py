"""A table of a job file, and the lines that say what is wrong with it."""

import difflib
from collections.abc import Iterable
from typing import Any, TypeVar, get_args

import pydantic
from pydantic import ConfigDict


class TomlTable(pydantic.BaseModel):
    """A table that refuses keys which it does not know."""

    model_config = ConfigDict(extra="forbid", frozen=True)


_T = TypeVar("_T", bound=TomlTable)


def validated(
    table: type[_T],
    raw: object,
    place: str,
    problems: list[str],
    also: tuple[str, ...] = (),
) -> _T | None:
    """Return a checked table.

    Args:
        table: Its class.
        raw: What the file holds.
        place: What a line calls the table, such as "[cutter]".
        problems: Receives a line for everything that is wrong.
        also: Keys that are allowed but read elsewhere.

    Returns:
        The table, or None if it has a fault.
    """
    try:
        return table.model_validate(raw)
    except pydantic.ValidationError as error:
        problems.extend(
            f"{place} {_describe(table, dict(fault), also)}"
            for fault in error.errors(include_url=False)
        )
        return None


def _describe(
    table: type[TomlTable], fault: dict[str, Any], also: tuple[str, ...]
) -> str:
    """Return one fault: key, what was found, what is allowed."""
    # A choice of types adds their names to the place of the fault.
    keys = [str(part) for part in fault["loc"] if "[" not in str(part)]
    key = ".".join(keys)
    owner = _owner(table, keys)
    kind, found, context = fault["type"], fault["input"], fault.get("ctx", {})
    if kind == "missing":
        wanted = owner.model_fields[keys[-1]].description
        return f"{key}: found nothing, but it is required: {wanted}"
    if kind == "extra_forbidden":
        more = also if owner is table else ()
        allowed = (*owner.model_fields, *more)
        text = f"{key}: found an unknown key; allowed: {', '.join(allowed)}"
        return text + meant_by(keys[-1], allowed)
    if kind == "value_error":
        return f"{key}: {context['error']}"
    if kind == "literal_error":
        return f"{key}: found {found!r}; allowed: {context['expected']}"
    wanted = {
        "int_type": "a whole number is required",
        "bool_type": "true or false is required",
        "string_type": "text is required",
        "list_type": "a list is required",
        "model_type": "a table is required",
        "greater_than_equal": f"at least {context.get('ge')} is required",
        "less_than_equal": f"at most {context.get('le')} is allowed",
        "too_short": f"{context.get('min_length')} values are required",
        "too_long": f"only {context.get('max_length')} values are allowed",
        "string_too_short": "a name is required",
    }.get(kind, fault["msg"])
    place = f"{key}: " if key else ""
    return f"{place}found {found!r}, but {wanted}"


def meant_by(name: str, allowed: Iterable[str]) -> str:
    """Return the name that was probably meant, as part of a message, or nothing."""
    near = difflib.get_close_matches(name, list(allowed), n=1, cutoff=0.75)
    return f"; perhaps {near[0]} is meant" if near else ""


def _owner(table: type[TomlTable], keys: list[str]) -> type[TomlTable]:
    """Return the table, or table within it, that holds the last key."""
    for key in keys[:-1]:
        field = table.model_fields.get(key)
        types = [] if field is None else [field.annotation]
        # The annotation may be a choice, a list, or both, of tables.
        while types:
            inner = types.pop()
            types.extend(get_args(inner))
            if isinstance(inner, type) and issubclass(inner, TomlTable):
                table = inner
    return table
