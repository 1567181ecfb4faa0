"""Jobs and identifications: TOML documents, checked as a whole, and what they build."""

from .._toml import JobError as JobError
from ._check.rapids import holder_notes as holder_notes, shank_notes as shank_notes
from ._load_identification import (
    Study as Study,
    load_identification as load_identification,
)
from ._load_job import (
    job_precision as job_precision,
    load_job as load_job,
)
from ._toml_snippets import (
    doubted as doubted,
    force_toml as force_toml,
    joints_toml as joints_toml,
    snippet as snippet,
    uncertainty_toml as uncertainty_toml,
)
