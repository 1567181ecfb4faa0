"""Settings: the keys of a job file, and the objects that scripts pass.

What it models: each table of settings is one frozen class, a field per key with its
type, default and description. A job file gives its values as text with units, a script
as floats in SI; both make the same object. A strategy, such as the objective of a
correction, has a class of its own, whose keys stand beside its name in its table: a
class that a script adds is a choice of job files from then on.
Assumptions: what is built from settings is beside the science that they are for.
Left out: JAX, so that a job's tables are checked before it is imported; what follows
from other tables, which `diffmill.config` fills in.
"""

import importlib
from types import ModuleType

_MODULES = (
    *("base", "correction", "fields", "force", "machine_errors", "output"),
    *("simulation", "tables", "truth"),
)


def __getattr__(name: str) -> ModuleType:
    """Import a module when it is first used."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return importlib.import_module(f".{name}", __name__)


def __dir__() -> list[str]:
    """Names of the modules, imported or not."""
    return sorted({*globals(), *_MODULES})
