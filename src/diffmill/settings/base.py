"""Classes of settings: a field per key of a job file, and strategies by their names."""

import copy
import dataclasses
import functools
import operator
from collections.abc import Callable, Iterable, Mapping
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    SupportsFloat,
    TypeAlias,
    TypeVar,
    dataclass_transform,
    get_args,
    get_type_hints,
)

from pydantic import ConfigDict, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

if TYPE_CHECKING:
    from .._types import RealScalarLike
else:
    # Arrays too, whose classes would import JAX.
    RealScalarLike = SupportsFloat

_T = TypeVar("_T")
_Settings = TypeVar("_Settings", bound="Settings")
_Function = TypeVar("_Function", bound=Callable[..., object])
_Strategy = TypeVar("_Strategy", bound="Strategy")
_LEAF = "leaf"
# A number that compiled programs take as an argument, so that another value compiles
# nothing anew; a file holds what the type within says.
Leaf: TypeAlias = Annotated[_T | RealScalarLike, _LEAF]


@dataclasses.dataclass(frozen=True)
class ReadAs:
    """Annotation of a field whose value stands in a file in another form.

    Attributes:
        type: Type of the value in a file.
        convert: Value of the field from that of the file.
    """

    type: object
    convert: Callable[..., object]

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Schema of the value in a file, and its conversion."""
        del source
        inner = handler.generate_schema(self.type)
        return core_schema.no_info_after_validator_function(self.convert, inner)


def key(
    description: str,
    *,
    default: object = dataclasses.MISSING,
    name: str | None = None,
    follows: bool = False,
    works_with: Mapping[str, str] | None = None,
    converter: Callable[[object], object] | None = None,
) -> _T:  # pyright: ignore[reportInvalidTypeVarUse]
    """Field of a class of settings that is a key of its table in a job file.

    Args:
        description: Meaning of the key, as the documentation and messages state it.
        default: Value if it is left out; without one it is required.
        name: The key, where it is not the name of the field.
        follows: True if a key that a file leaves out follows from the rest of the job:
            it is None until `diffmill.config` fills it in. The default is that of
            scripts.
        works_with: Other keys of the table, by name, with the only values beside which
            this one may be given; where a key names a strategy, the attribute of its
            class that must be true.
        converter: Value of the field from that of a script.
    """
    metadata: dict[str, object] = {"description": description, "follows": follows}
    if name is not None:
        metadata["alias"] = name
    metadata["works_with"] = dict(works_with or {})
    metadata["converter"] = converter
    made: Any = dataclasses.field(default=default, metadata=metadata)
    return made


@dataclass_transform(frozen_default=True, field_specifiers=(key, dataclasses.field))
@dataclasses.dataclass(frozen=True)
class Settings:
    """Base of a table of settings.

    A class below it is a frozen dataclass. Its fields that are made by `key` are keys
    of a job file; others follow from the job.
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid")
    # Place of the table in a job file, such as "correction.uncertainty".
    table: ClassVar[str] = ""

    def __init_subclass__(cls, *, table: str = ""):
        if table:
            cls.table = table
        dataclasses.dataclass(frozen=True)(cls)
        if any(field.metadata.get("converter") for field in dataclasses.fields(cls)):
            _take_keys_of_strategies(cls)

    @classmethod
    @functools.cache
    def hints(cls) -> dict[str, object]:
        """Types of the fields, by their names."""
        return get_type_hints(cls, include_extras=True)

    @classmethod
    def keys(cls) -> dict[str, dataclasses.Field[object]]:
        """Fields that are keys of a file, by the names of the keys."""
        return {
            field.metadata.get("alias", field.name): field
            for field in dataclasses.fields(cls)
            if "description" in field.metadata
        }

    @classmethod
    def choices(cls) -> Iterable[tuple[dataclasses.Field[object], "type[Strategy]"]]:
        """Fields that hold a strategy, each with its family."""
        hints = cls.hints()
        for field in dataclasses.fields(cls):
            kind = hints[field.name]
            if isinstance(kind, type) and issubclass(kind, Strategy):
                yield field, kind

    @classmethod
    def unfinished(cls: type[_Settings], values: Mapping[str, object]) -> _Settings:
        """Settings of a file, unchecked: None for keys that follow from the job.

        Args:
            values: Values of the keys, by the names of their fields.
        """
        made = object.__new__(cls)
        for field in dataclasses.fields(cls):
            value = values.get(field.name, field.default)
            object.__setattr__(made, field.name, value)
        return made

    def misplaced(self) -> Iterable[str]:
        """Faults of keys beside values of others with which they do not work."""
        own = self.keys()
        for name, field in own.items():
            unset = None if field.metadata["follows"] else field.default
            if getattr(self, field.name) == unset:
                continue
            for other, allowed in field.metadata["works_with"].items():
                found, names = getattr(self, own[other].name), [allowed]
                if isinstance(found, Strategy):
                    every = found.members.items()
                    names = [word for word, one in every if getattr(one, allowed)]
                    found = found.name
                if found not in names:
                    texts = " or ".join(f'"{word}"' for word in names)
                    yield (
                        f'{name}: found beside {other} = "{found}", but it works with '
                        f"{other} = {texts} only"
                    )

    def leaf_names(self) -> tuple[str, ...]:
        """Names of the fields that are leaves; of a strategy's with a dot."""
        own, strategies = _leaf_fields(type(self))
        nested = (
            f"{field}.{name}"
            for field in strategies
            for name in getattr(self, field).leaf_names()
        )
        return (*own, *nested)

    def leaves(self) -> list[object]:
        """Values of the leaves, in the order of their names."""
        return [operator.attrgetter(name)(self) for name in self.leaf_names()]

    def with_leaves(self: _Settings, values: Iterable[object]) -> _Settings:
        """Settings with other leaves, in the order of their names, not checked."""
        changed = copy.copy(self)
        for name, value in zip(self.leaf_names(), values, strict=True):
            owner = changed
            *path, last = name.split(".")
            for step in path:
                inner = copy.copy(getattr(owner, step))
                object.__setattr__(owner, step, inner)
                owner = inner
            object.__setattr__(owner, last, value)
        return changed


@functools.cache
def _leaf_fields(kind: type[Settings]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Fields of a class that are leaves, and those that hold a strategy."""
    hints = kind.hints().items()
    own = (n for n, hint in hints if _LEAF in getattr(hint, "__metadata__", ()))
    return tuple(own), tuple(field.name for field, _ in kind.choices())


class Strategy(Settings):
    """Base of the families of strategies.

    A class directly below it is a family, such as the objectives of a correction. One
    below a family is a choice, `name` the word for it in a job file; its keys stand in
    the family's table.

    Attributes:
        name: Name of a strategy in a job file.
        members: Classes of a family by their names.
        builder: What `builds` has registered for a strategy.
    """

    name: ClassVar[str] = ""
    members: ClassVar[dict[str, "type[Strategy]"]] = {}
    builder: ClassVar[Callable[..., object] | None] = None

    def __init_subclass__(cls, *, name: str = "", table: str = ""):
        super().__init_subclass__(table=table)
        if Strategy in cls.__bases__:
            cls.members = {}
        if name:
            cls.name = name
            cls.members[name] = cls

    @classmethod
    def each(cls: type[_Strategy]) -> dict[str, type[_Strategy]]:
        """Classes of the strategies of this family, by their names."""
        found = cls.members.items()
        return {name: kind for name, kind in found if issubclass(kind, cls)}

    @classmethod
    def named(cls: type[_Strategy], name: object) -> type[_Strategy]:
        """Class of a strategy of this family.

        Raises:
            ValueError: There is none of this name.
        """
        strategies = cls.each()
        if isinstance(name, str) and name in strategies:
            return strategies[name]
        *most, last = map(repr, strategies)
        allowed = f"{', '.join(most)} or {last}" if most else last
        raise ValueError(f"found {name!r}; allowed: {allowed}")

    @classmethod
    def of(cls: type[_Strategy], value: object) -> _Strategy:
        """Settings of a strategy, given themselves or by a name."""
        return value if isinstance(value, cls) else cls.named(value)()

    def build(self, *parts: object) -> object:
        """The strategy, made by its builder from these settings and parts of the job.

        Raises:
            ValueError: The strategy has no builder.
        """
        builder = type(self).builder
        if builder is None:
            raise ValueError(
                f"Argument `settings` must have a builder, but {self!r} has none: see "
                "`diffmill.settings.base.builds`."
            )
        return builder(self, *parts)


def builds(kind: type[Strategy]) -> Callable[[_Function], _Function]:
    """Register the function that makes a strategy from its settings.

    Args:
        kind: Class of the settings.

    Returns:
        A decorator of the function, which takes the settings and the parts of a job
        that its family names.
    """

    def register(function: _Function) -> _Function:
        kind.builder = staticmethod(function)
        return function

    return register


def _take_keys_of_strategies(kind: type[Settings]) -> None:
    """Let a class be made from names of strategies, and with their keys."""
    make = kind.__init__

    @functools.wraps(make)
    def __init__(self: Settings, **values: Any) -> None:
        for field, _ in kind.choices():
            chosen = field.metadata["converter"](values.get(field.name, field.default))
            names = [own.name for own in dataclasses.fields(chosen)]
            own = {name: values.pop(name) for name in names if name in values}
            values[field.name] = dataclasses.replace(chosen, **own)
        make(self, **values)

    kind.__init__ = __init__


def file_type(hint: object) -> object:
    """Type of the value that a file holds for a field, with its validation."""
    if _LEAF in getattr(hint, "__metadata__", ()):
        return get_args(get_args(hint)[0])[0]
    return hint
