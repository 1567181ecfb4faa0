"""Predict and correct the path error of a milling robot.

`load_job` reads a job, `simulate` predicts it, `correct` corrects it, `stack` makes one
of several for `vmap`, `use_compile_cache` keeps what is compiled; the parts are in the
subpackages. Arrays are SI, frames and signs are in `docs/conventions.md`.

Importing the package imports nothing else: every name is looked up when it is first
used, so that help on the command line does not wait for JAX.
"""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from . import (
        campaign as campaign,
        config as config,
        correction as correction,
        cutter as cutter,
        cutting as cutting,
        examples as examples,
        identification as identification,
        io as io,
        numerics as numerics,
        optimise as optimise,
        process as process,
        robot as robot,
        settings as settings,
        sim as sim,
        toolpath as toolpath,
        units as units,
        viz as viz,
        workpiece as workpiece,
    )
    from ._jax_config import use_compile_cache as use_compile_cache
    from ._job import (
        Job as Job,
    )
    from ._result import RESULTS as RESULTS, SimulationFailed as SimulationFailed
    from ._toml import JobError as JobError
    from .config import load_job as load_job
    from .correction import Correction as Correction, correct as correct
    from .learning import learn as learn
    from .settings.correction import (
        CorrectionSettings as CorrectionSettings,
        LineWeight as LineWeight,
        UncertaintySettings as UncertaintySettings,
    )
    from .settings.simulation import (
        ScatterSettings as ScatterSettings,
        SimulationSettings as SimulationSettings,
    )
    from .settings.truth import TruthSettings as TruthSettings
    from .sim import Solution as Solution, simulate as simulate, stack as stack

    __version__: str

_MODULES = (
    "campaign",
    "config",
    "correction",
    "cutter",
    "cutting",
    "examples",
    "identification",
    "io",
    "learning",
    "numerics",
    "optimise",
    "process",
    "robot",
    "settings",
    "sim",
    "toolpath",
    "units",
    "viz",
    "workpiece",
)
# Where each of the other public names lives.
_NAMES = {
    "Correction": "correction",
    "CorrectionSettings": "settings.correction",
    "Job": "_job",
    "LineWeight": "settings.correction",
    "JobError": "_toml",
    "RESULTS": "_result",
    "ScatterSettings": "settings.simulation",
    "SimulationFailed": "_result",
    "SimulationSettings": "settings.simulation",
    "Solution": "sim",
    "TruthSettings": "settings.truth",
    "UncertaintySettings": "settings.correction",
    "correct": "correction",
    "learn": "learning",
    "load_job": "config",
    "simulate": "sim",
    "stack": "sim",
    "use_compile_cache": "_jax_config",
}


def __getattr__(name: str) -> object:
    """Import a public name when it is first used."""
    if name in _MODULES:
        return importlib.import_module(f"{__name__}.{name}")
    if name in _NAMES:
        value = getattr(importlib.import_module(f"{__name__}.{_NAMES[name]}"), name)
    elif name == "__version__":
        from importlib import metadata

        value = metadata.version("diffmill")
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names, imported or not."""
    return sorted({*globals(), *_MODULES, *_NAMES, "__version__"})
