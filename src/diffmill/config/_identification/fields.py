"""Types of values in an identification file: axes, columns, sections."""

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, StrictStr

from ...settings.fields import Time


def _axes(value: object) -> object:
    """Three signed axes that are all different."""
    if isinstance(value, list) and len(value) == 3:
        names = [str(name).lstrip("+") for name in value]
        if sorted(name.lstrip("-") for name in names) == ["x", "y", "z"]:
            return names
    raise ValueError(
        f"found {value!r}, but for x, y, z of the work the recorded axis is required, "
        'each once and with a minus if mirrored, such as ["-y", "x", "z"]'
    )


def _axes_or_proposed(value: object) -> object:
    """Three signed axes, or the word for the likeliest ones."""
    if value == "proposed":
        return value
    try:
        return _axes(value)
    except ValueError as error:
        raise ValueError(f'{error}; or "proposed" for the likeliest') from None


def _channels(value: object) -> object:
    """Names or numbers of columns by quantity; "none" becomes None.

    A list is the sum of its columns.
    """
    if not isinstance(value, dict):
        raise ValueError(
            f"found {value!r}, but a table is required, such as "
            '{ time = "t", Fx = "Ch1", Fy = "Ch2", Fz = 4 }'
        )
    found: dict[str, str | int | list[str | int] | None] = {}
    for key, column in value.items():
        columns = column if isinstance(column, list) and column else [column]
        is_sum = columns is column
        if any(
            isinstance(one, bool)
            or not isinstance(one, str | int)
            or (is_sum and one == "none")
            for one in columns
        ):
            raise ValueError(
                f"found {column!r} for {key}, but the name of a column, its number "
                'from 1, "none", or a list of columns to be summed is required'
            )
        found[key] = None if column == "none" else column
    return found


def _span(value: object) -> object:
    """Two ends of a section, or the word for no section."""
    if value == "none" or (isinstance(value, list) and len(value) == 2):
        return value
    raise ValueError(
        f'found {value!r}, but begin and end are required, such as ["0 s", "0.5 s"], '
        'or "none"'
    )


def _cut_number(value: object) -> object:
    """Number of a cut from 1, or the word for all."""
    is_number = isinstance(value, int) and not isinstance(value, bool) and value > 0
    if value == "all" or is_number:
        return value
    raise ValueError(
        f'found {value!r}, but the number of a cut from 1, or "all", is required'
    )


Axes = Annotated[list[str], BeforeValidator(_axes)]
AxesOrProposed = Annotated[list[str] | str, BeforeValidator(_axes_or_proposed)]
Channels = Annotated[
    dict[str, str | int | list[str | int] | None], BeforeValidator(_channels)
]
Span = Annotated[list[Time] | Literal["none"], BeforeValidator(_span)]
CutNumber = Annotated[int | Literal["all"], BeforeValidator(_cut_number)]
File = Annotated[StrictStr, Field(min_length=1)]
Side = Literal["slot", "up", "down"]
