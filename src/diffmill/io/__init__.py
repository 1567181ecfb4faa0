"""Files in and out: jobs, programs, recorded paths, results.

A job is a TOML file whose every quantity is text with a unit; it is checked as a
whole, so that one error lists everything wrong with it and with the program that it
names. Programs are G-code (three axes, the words listed by `diffmill.io.GCodeError`)
or recorded paths as CSV. Results are written to a temporary folder that is renamed at
the end, so that a folder of results is complete or absent.

Stock is a block, a closed mesh, or what an earlier run left. G-code is for an upright
tool; a path as CSV may carry tool axes.
Measured forces are read as they stand, from text or what laboratory programs write.
What `diffmill identify` is to find out stands in a TOML file like a job.
Leaves out robot programs.
"""

from ._checkpoint import (
    CheckpointError as CheckpointError,
    DamagedCheckpoint as DamagedCheckpoint,
    fingerprint as fingerprint,
    has_checkpoint as has_checkpoint,
    latest_checkpoint as latest_checkpoint,
    previous_checkpoint as previous_checkpoint,
    read_checkpoint as read_checkpoint,
    remove_checkpoint as remove_checkpoint,
    write_checkpoint as write_checkpoint,
)
from ._gcode import parse_gcode as parse_gcode, read_gcode as read_gcode
from ._gcode_words import GCodeError as GCodeError
from ._gcode_writer import write_gcode as write_gcode
from ._identification_task import (
    CoupledTask as CoupledTask,
    ForceRecord as ForceRecord,
    ForceRecordTask as ForceRecordTask,
    ForceSettings as ForceSettings,
    FrequencyResponse as FrequencyResponse,
    LoadTestTask as LoadTestTask,
    MeanForceTask as MeanForceTask,
    ModeTask as ModeTask,
    RingDown as RingDown,
    StraightCut as StraightCut,
)
from ._identified_toml import (
    doubted as doubted,
    force_toml as force_toml,
    joints_toml as joints_toml,
    snippet as snippet,
    uncertainty_toml as uncertainty_toml,
)
from ._job_checks import holder_notes as holder_notes, shank_notes as shank_notes
from ._load_identification import load_identification as load_identification
from ._load_job import (
    JobError as JobError,
    job_precision as job_precision,
    load_job as load_job,
)
from ._load_record import load_record as load_record
from ._path_csv import (
    PathFileError as PathFileError,
    parse_path_csv as parse_path_csv,
    read_path_csv as read_path_csv,
    write_path_csv as write_path_csv,
)
from ._pose import parse_pose as parse_pose
from ._rapid_check import (
    RigidPass as RigidPass,
    rigid_pass as rigid_pass,
    rigid_pass_of_stock as rigid_pass_of_stock,
)
from ._record_error import RecordError as RecordError
from ._results import (
    ResultsError as ResultsError,
    check_folder as check_folder,
    described as described,
    mark_incomplete as mark_incomplete,
    write_folder as write_folder,
    write_results as write_results,
)
