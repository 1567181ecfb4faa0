"""Jobs, campaigns and identifications as TOML, checked as a whole."""

from .._toml import JobError as JobError
from ._check.rapids import tool_notes as tool_notes
from ._job_program import JobProgram as JobProgram
from ._load_campaign import Campaign as Campaign, load_campaign as load_campaign
from ._load_identification import (
    Study as Study,
    load_identification as load_identification,
)
from ._load_job import (
    job_precision as job_precision,
    load_job as load_job,
)
