"""The example `paper_small`, with other settings of the correction."""

import pathlib
import tempfile

import diffmill as dm
from diffmill import examples


def small_job(more: str = "") -> dm.Job:
    """Return the example job with lines added to its table `[correction]`."""
    with tempfile.TemporaryDirectory() as folder:
        file = examples.copy_example("paper_small", pathlib.Path(folder))
        # The table is the last of the file.
        file.write_text(file.read_text().rstrip() + "\n" + more)
        return dm.load_job(file)
