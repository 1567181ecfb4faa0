"""Jobs and identifications: TOML documents, checked as a whole, and what they build."""

from .._toml import JobError as JobError
from ._check.rapids import holder_notes as holder_notes, shank_notes as shank_notes
from ._identification.tasks import (
    CoupledTask as CoupledTask,
    ForceRecord as ForceRecord,
    ForceRecordTask as ForceRecordTask,
    FrequencyResponse as FrequencyResponse,
    LoadTestTask as LoadTestTask,
    MeanForceTask as MeanForceTask,
    ModeTask as ModeTask,
    RingDown as RingDown,
    StraightCut as StraightCut,
)
from ._load_identification import load_identification as load_identification
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
