"""Jobs, campaigns and identifications as TOML, checked as a whole.

What is not needed is not imported: the tables of a job are checked without JAX, so that
a key that is not known is refused at once.
"""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ._build.program import program_setup as program_setup
    from ._check.rapids import tool_notes as tool_notes
    from ._check.tables import check_tables as check_tables
    from ._job_program import JobProgram as JobProgram
    from ._load_campaign import Campaign as Campaign, load_campaign as load_campaign
    from ._load_identification import load_identification as load_identification
    from ._load_job import job_precision as job_precision, load_job as load_job
    from ._load_learning import (
        MeasuredJob as MeasuredJob,
        load_learning as load_learning,
    )

# Where each public name lives.
_NAMES = {
    "Campaign": "._load_campaign",
    "JobProgram": "._job_program",
    "MeasuredJob": "._load_learning",
    "check_tables": "._check.tables",
    "job_precision": "._load_job",
    "load_campaign": "._load_campaign",
    "load_identification": "._load_identification",
    "load_job": "._load_job",
    "load_learning": "._load_learning",
    "program_setup": "._build.program",
    "tool_notes": "._check.rapids",
}


def __getattr__(name: str) -> object:
    """Import a public name when it is first used."""
    if name not in _NAMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = importlib.import_module(_NAMES[name], __name__)
    globals()[name] = value = getattr(module, name)
    return value


def __dir__() -> list[str]:
    """Public names, imported or not."""
    return sorted({*globals(), *_NAMES})
