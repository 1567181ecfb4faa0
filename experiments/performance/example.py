"""A built-in example as a job."""

import pathlib
import tempfile

import diffmill as dm
from diffmill.examples import copy_example


def load_example(name):
    """Return the job of an example."""
    with tempfile.TemporaryDirectory() as folder:
        return dm.load_job(copy_example(name, pathlib.Path(folder)))
