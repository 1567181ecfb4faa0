"""Tables of a file: their values, and a line for each fault."""

import dataclasses
import difflib
import functools
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, TypeVar, get_args

import pydantic
from pydantic import ConfigDict

from .base import ReadAs, Settings, Strategy, file_type


class TomlTable(pydantic.BaseModel):
    """A table that refuses keys which it does not know."""

    model_config = ConfigDict(extra="forbid", frozen=True)


_T = TypeVar("_T", bound=TomlTable)
_S = TypeVar("_S", bound=Settings)


def read_settings(
    kind: type[_S],
    raw: object,
    problems: list[str],
    place: str = "",
    also: tuple[str, ...] = (),
) -> _S | None:
    """Settings that a table of a job file states.

    Keys of strategies that are not chosen are checked and left out.

    Args:
        kind: Their class.
        raw: The parsed table.
        problems: Receives a line for everything that is wrong.
        place: What a line calls the table; that of its class if left out.
        also: Keys that are allowed but read elsewhere.

    Returns:
        The settings, None for keys that follow from the rest of the job; None after a
        fault.
    """
    stated = raw if isinstance(raw, Mapping) else {}
    members = []
    for field, family in kind.choices():
        name = stated.get(field.name)
        chosen = family.each().get(name) if isinstance(name, str) else None
        first = chosen or family.named(field.default)
        members += [first, *family.each().values()]
    table = _file_table(kind, tuple(dict.fromkeys(members)))
    found = validated(table, raw, place or f"[{kind.table}]", problems, also)
    if found is None:
        return None
    values = {f.name: getattr(found, name) for name, f in kind.keys().items()}
    for field, family in kind.choices():
        chosen = family.named(values[field.name])
        own = {f.name: getattr(found, name) for name, f in chosen.keys().items()}
        values[field.name] = chosen(**own)
    return kind.unfinished(values)


def idle_keys(kind: type[Settings], raw: object) -> dict[str, str]:
    """Keys of strategies that a table does not choose, with what would choose them."""
    idle: dict[str, str] = {}
    if not isinstance(raw, Mapping):
        return idle
    for field, family in kind.choices():
        chosen = family.of(raw.get(field.name, field.default))
        for name, member in family.each().items():
            for key in member.keys().keys() - chosen.keys().keys():
                if key in raw:
                    idle[key] = f'{field.name} = "{name}"'
    return idle


@functools.cache
def _file_table(
    kind: type[Settings], strategies: tuple[type[Strategy], ...]
) -> type[TomlTable]:
    """Table of a file for a class of settings, with the keys of strategies.

    Of strategies that have a key in common the first says what it holds.
    """
    families = {field.name: family for field, family in kind.choices()}
    fields: dict[str, Any] = {}
    for owner in (kind, *strategies):
        hints = owner.hints()
        for name, field in owner.keys().items():
            default, hint = field.default, file_type(hints[field.name])
            if field.metadata["follows"]:
                default = None
            elif default is dataclasses.MISSING:
                default = ...
            if owner is kind and name in families:
                hint = _name_in(families[name])
            info = pydantic.Field(default, description=field.metadata["description"])
            fields.setdefault(name, (hint, info))
    return pydantic.create_model(kind.__name__, __base__=TomlTable, **fields)


def _name_in(family: type[Strategy]) -> Any:
    """Type of the name of a strategy of a family."""

    def check(name: object) -> object:
        family.named(name)
        return name

    return Annotated[str, pydantic.BeforeValidator(check)]


def validated(
    table: type[_T],
    raw: object,
    place: str,
    problems: list[str],
    also: tuple[str, ...] = (),
) -> _T | None:
    """Checked table of a file.

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
    """Line of one fault: key, value, and what is allowed."""
    # A choice of types adds their names to the place of the fault.
    keys = [str(part) for part in fault["loc"] if "[" not in str(part)]
    key = ".".join(keys)
    owner = _owner(table, keys)
    kind, found, context = fault["type"], fault["input"], fault.get("ctx", {})
    if kind == "missing":
        wanted = _meanings(owner)[keys[-1]]
        return f"{key}: found nothing, but it is required: {wanted}"
    if kind in ("extra_forbidden", "unexpected_keyword_argument"):
        more = also if owner is table else ()
        allowed = (*_meanings(owner), *more)
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
        "dataclass_type": "a table is required",
        "greater_than_equal": f"at least {context.get('ge')} is required",
        "less_than_equal": f"at most {context.get('le')} is allowed",
        "too_short": f"{context.get('min_length')} values are required",
        "too_long": f"only {context.get('max_length')} values are allowed",
        "string_too_short": "a name is required",
    }.get(kind, fault["msg"])
    place = f"{key}: " if key else ""
    return f"{place}found {found!r}, but {wanted}"


def meant_by(name: str, allowed: Iterable[str]) -> str:
    """Name that was probably meant, as part of a message, or nothing."""
    near = difflib.get_close_matches(name, list(allowed), n=1, cutoff=0.75)
    return f"; perhaps {near[0]} is meant" if near else ""


def _owner(
    table: type[TomlTable] | type[Settings], keys: list[str]
) -> type[TomlTable] | type[Settings]:
    """Table, or table within it, that holds the last key."""
    for key in keys[:-1]:
        types = [_hint(table, key)]
        # The annotation may be a choice, a list, or both, of tables.
        while types:
            inner = types.pop()
            types.extend(get_args(inner))
            if isinstance(inner, ReadAs):
                types.append(inner.type)
            if isinstance(inner, type) and issubclass(inner, TomlTable | Settings):
                table = inner
    return table


def _hint(table: type[TomlTable] | type[Settings], key: str) -> object:
    """Type of a key, None if there is no such key."""
    if issubclass(table, TomlTable):
        field = table.model_fields.get(key)
        return None if field is None else field.rebuild_annotation()
    field = table.keys().get(key)
    return None if field is None else table.hints()[field.name]


def _meanings(table: type[TomlTable] | type[Settings]) -> dict[str, str | None]:
    """Keys of a table with their descriptions."""
    if issubclass(table, TomlTable):
        return {name: field.description for name, field in table.model_fields.items()}
    return {name: f.metadata["description"] for name, f in table.keys().items()}
