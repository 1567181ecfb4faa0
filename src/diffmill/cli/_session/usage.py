"""Faults of commands and options as they were typed, in one line."""

import dataclasses
import inspect
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NoReturn, get_args, get_origin

from .errors import BadInput

_HELP = ("-h", "--help")
_SHELLS = ("bash", "zsh", "fish")


def check_usage(
    commands: Mapping[str, Callable[..., object]], argv: Sequence[str]
) -> None:
    """Refuse an unknown command or option, and missing, further or unread values.

    Args:
        commands: Functions by the name of their command; what may be given by position
            is a positional parameter, an option is keyword-only.
        argv: Arguments of the command line.

    Raises:
        BadInput: With what was found and what is allowed.
    """
    if not argv or argv[0].startswith("-"):
        if argv and argv[0] in _HELP:
            return
        found = f"the option {argv[0]}" if argv else "no command"
        _refuse(f"found {found}", [*commands, "--help", "--version", "--completion"])
    name, *tokens = argv
    if name not in commands:
        _refuse(f"found the command {name!r}", commands)
    if not set(tokens) & set(_HELP):
        _check_command(name, commands[name], tokens)


def shell_of(argv: Sequence[str]) -> str:
    """Shell whose completion is asked for.

    Args:
        argv: `--completion` and what follows it.

    Raises:
        BadInput: It is not one shell that is known.
    """
    if len(argv) != 2 or argv[1] not in _SHELLS:
        _refuse(f"--completion: found {' '.join(argv[1:]) or 'nothing'}", _SHELLS)
    return argv[1]


def _check_command(
    name: str, command: Callable[..., object], tokens: list[str]
) -> None:
    parameters = list(inspect.signature(command).parameters.values())
    places = [p for p in parameters if p.kind is not p.KEYWORD_ONLY]
    options = {}
    for parameter in parameters:
        if parameter.kind is parameter.KEYWORD_ONLY:
            options |= _options(parameter.name, parameter.annotation)
    given = 0
    while tokens:
        token = tokens.pop(0)
        if not _is_option(token):
            given += 1
            if given > len(places):
                expected = " ".join(_metavar(place) for place in places)
                _refuse(f"{name}: found {token!r}", [expected], "after the command")
            continue
        option, has_value, _ = token.partition("=")
        option = option.replace("_", "-").replace("--no-", "--")
        if option not in options:
            _refuse(f"{name}: found the option {token}", [*options, "--help"])
        if options[option] is not bool and not has_value:
            _check_values(f"{name} {option}", options[option], tokens)
    for place in places[given:]:
        if place.default is place.empty:
            _refuse(f"{name}: found no {_metavar(place)}", [], "it is required")


def _options(name: str, annotation: Any) -> dict[str, Any]:
    """Types of the options that a parameter stands for, by `--name`."""
    kind = get_args(annotation)[0]
    if not dataclasses.is_dataclass(kind):
        return {f"--{name.replace('_', '-')}": kind}
    options = {}
    for field in dataclasses.fields(kind):
        options |= _options(field.name, field.type)
    return options


def _check_values(where: str, kind: Any, tokens: list[str]) -> None:
    """Take the values of an option from the tokens; a number must be one."""
    is_many = get_origin(kind) is tuple
    count = 0
    while tokens and not _is_option(tokens[0]) and (is_many or not count):
        value = tokens.pop(0)
        count += 1
        if is_many and get_args(kind)[0] is float and not _is_number(value):
            _refuse(f"{where}: found {value!r}", [], "numbers are required")
    if not count and not is_many:
        _refuse(f"{where}: found no value", [], "one is required")


def _is_option(token: str) -> bool:
    # Quantities have a sign and a unit: "-10 deg".
    return re.match(r"-(?![\d.])\S", token) is not None


def _is_number(token: str) -> bool:
    try:
        float(token)
    except ValueError:
        return False
    return True


def _metavar(place: inspect.Parameter) -> str:
    names = (getattr(mark, "metavar", None) for mark in get_args(place.annotation))
    return next(name for name in names if name)


def _refuse(found: str, allowed: Iterable[str], why: str = "") -> NoReturn:
    """Refuse a word; without a list of allowed ones, say why."""
    listed = ", ".join(allowed)
    wanted = f"allowed{f' {why}' if why else ''}: {listed}" if listed else why
    raise BadInput(f"{found}; {wanted}")
