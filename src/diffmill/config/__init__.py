"""Jobs and identifications: TOML documents, checked as a whole, and what they build."""

from .._toml import JobError as JobError
from ._check.rapids import tool_notes as tool_notes
from ._load_identification import (
    Study as Study,
    load_identification as load_identification,
)
from ._load_job import (
    job_precision as job_precision,
    load_job as load_job,
)
