"""The columns of a file, whatever its format."""

import pathlib
import re

from .binary import read_mat, read_netcdf, read_tdms
from .table import Table
from .text import read_text
from .uff import read_uff


def read_table(file: pathlib.Path) -> Table:
    """Return the columns of a file; what it begins with decides, then its suffix.

    Raises:
        RecordError: If no columns are in it.
        OSError: If the file cannot be read.
    """
    with file.open("rb") as stream:
        begin = stream.read(128)
    suffix = file.suffix.lower()
    if begin.startswith(b"TDSm") or suffix == ".tdms":
        return read_tdms(file)
    if begin.startswith(b"MATLAB") or suffix == ".mat":
        return read_mat(file)
    if begin.startswith((b"\x89HDF", b"CDF")) or suffix in (".nc", ".nc4", ".cdf"):
        return read_netcdf(file)
    if re.match(rb"\s*-1\r?\n *\d+", begin) or suffix in (".uff", ".unv"):
        return read_uff(file)
    return read_text(file)
