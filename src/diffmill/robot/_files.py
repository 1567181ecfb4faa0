"""Read robots from files: the only module of this subpackage that touches files."""

import os
import tomllib
from importlib import resources
from pathlib import Path

from ._build import build
from ._robot import Robot
from ._schema import RobotFileError, read_elements


def built_in_models() -> list[str]:
    """Return the names of the models that come with the package."""
    folder = resources.files("diffmill.robot").joinpath("models")
    names = [entry.name for entry in folder.iterdir()]
    return sorted(n.removesuffix(".toml") for n in names if n.endswith(".toml"))


def load(model_or_file: str | os.PathLike[str], *, tool: str | None = None) -> Robot:
    """Return a robot from a built-in model or from a TOML file.

    Args:
        model_or_file: Name of a built-in model, or path of a robot file (.toml).
        tool: Name of the tool to use; may be left out if there is only one.

    Returns:
        The robot; its arrays have the floating point type that is JAX's default at
        the time of the call.

    Raises:
        ValueError: If there is no such model or file, or the file is faulty; a
            `RobotFileError` lists all faults at once.

    **Differentiability**: none; differentiate by the arrays of the `Robot`.
    """
    file = os.fspath(model_or_file)
    name, elements = read_elements(_parse(_read_text(file), file), file)
    try:
        return build(elements, tool=tool, name=name)
    except ValueError as error:
        raise RobotFileError(f"{file}: {error}") from error


def _read_text(file: str) -> str:
    """Return the text of a model or file."""
    if file in built_in_models():
        model = resources.files("diffmill.robot").joinpath("models", f"{file}.toml")
        return model.read_text(encoding="utf-8")
    choices = (
        f"the built-in models are {', '.join(built_in_models())}; "
        "a file must be a robot description in TOML (.toml)"
    )
    if Path(file).suffix.lower() != ".toml":
        raise ValueError(
            f"Argument `model_or_file` is {file!r}, which is neither a built-in model "
            f"nor a .toml file: {choices}."
        )
    try:
        return Path(file).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(
            f"The robot file {file!r} cannot be read ({error}): {choices}."
        ) from error


def _parse(text: str, file: str) -> dict[str, object]:
    """Return the parsed TOML."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise RobotFileError(f"{file}: not valid TOML: {error}") from error
