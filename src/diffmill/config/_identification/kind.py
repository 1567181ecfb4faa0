"""A kind of identification: the tables of its file, and the study that they give.

`kind` says what was measured; it decides which tables there are. Every table is
checked on its own, so that a fault in one does not hide those of the others.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import TypeAlias, TypeVar

from ...identification import Study
from ...settings.tables import TomlTable, validated

_Toml = TypeVar("_Toml", bound=TomlTable)
# Classes of tables by their names; in a list that of the entries of a list of tables.
Tables: TypeAlias = Mapping[str, type[TomlTable] | list[type[TomlTable]]]


@dataclasses.dataclass(frozen=True)
class IdentificationKind:
    """Declaration of a kind of identification.

    Attributes:
        name: Value of `kind`.
        required: Tables that a file must have, by their names.
        optional: Tables that it may have.
        read: Builds the study. It takes the name of the file, the context, and each
            table as a keyword, None where the file has none or a faulty one; it returns
            None with problems noted.
    """

    name: str
    required: Tables
    optional: Tables
    read: Callable[..., Study | None]

    def tables(
        self, raw: Mapping[str, object], problems: list[str]
    ) -> dict[str, TomlTable | list[TomlTable] | None]:
        """Checked tables of a file by their names; None if absent or faulty.

        Args:
            raw: The parsed TOML.
            problems: Receives a line for everything that is wrong.
        """
        classes = {**self.required, **self.optional}
        headings = {
            name: f"[{name}]" if isinstance(table, type) else f"[[{name}]]"
            for name, table in classes.items()
        }
        problems += [
            f"{name}: found an unknown table or key; allowed for "
            f'kind = "{self.name}": {", ".join(headings.values())}'
            for name in raw
            if name != "kind" and name not in classes
        ]
        problems += [
            f"{headings[name]}: found no such table, but it is required"
            for name in self.required
            if name not in raw
        ]
        tables: dict[str, TomlTable | list[TomlTable] | None] = {}
        for name, table in classes.items():
            tables[name] = None
            if name not in raw:
                continue
            if isinstance(table, type):
                tables[name] = validated(table, raw[name], f"[{name}]", problems)
            else:
                tables[name] = _entries(name, table[0], raw[name], problems)
        return tables


def _entries(
    name: str, kind: type[_Toml], raw: object, problems: list[str]
) -> list[_Toml] | None:
    """Checked entries of a list of tables; None if one has a fault."""
    if not isinstance(raw, list) or not raw:
        problems.append(
            f"[[{name}]]: found {raw!r}, but a list of tables is required, each headed "
            f"[[{name}]]"
        )
        return None
    entries = [
        validated(kind, one, f"[[{name}]] {place}", problems)
        for place, one in enumerate(raw, 1)
    ]
    good = [one for one in entries if one is not None]
    return good if len(good) == len(entries) else None
