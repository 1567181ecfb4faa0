"""Files in and out: jobs, programs, recorded paths, results.

A job is a TOML file whose every quantity is text with a unit; it is checked as a whole,
so that one error lists everything wrong with it and with the program that it names.
Programs are G-code (three axes, the words listed by `diffmill.io.ProgramError`), KRL,
RAPID and APT as far as they are plain motion, or recorded paths as CSV. Results are
written to a temporary folder that is renamed at the end, so that a folder of results is
complete or absent.

Stock is a block, a closed mesh, or what an earlier run left. G-code is for an upright
tool; the others carry tool axes. Measured forces are read as they stand, from text or
what laboratory programs write. What `diffmill identify` is to find out stands in a TOML
file like a job.
"""

from ._checkpoint import CheckpointFile as CheckpointFile
from ._joint_positions import parse_pose as parse_pose
from ._path_csv import (
    read_path_csv as read_path_csv,
    write_path_csv as write_path_csv,
)
from ._programs.faults import ProgramError as ProgramError
from ._programs.formats import (
    PROGRAM_FORMATS as PROGRAM_FORMATS,
    read_program as read_program,
    write_program as write_program,
)
from ._programs.rs274.interpreter import (
    parse_gcode as parse_gcode,
)
from ._programs.rs274.writer import (
    program_frame as program_frame,
    write_gcode as write_gcode,
)
from ._programs.setup import ProgramSetup as ProgramSetup
from ._programs.stream import OffsetStream as OffsetStream
from ._records.load_record import load_record as load_record
from ._records.quantity import Quantity as Quantity
from ._records.reader import TableReader as TableReader
from ._records.table import RecordError as RecordError
from ._results import (
    described as described,
    mark_incomplete as mark_incomplete,
    write_results as write_results,
)
