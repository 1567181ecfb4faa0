"""Programs and jobs that tests read from a file."""

import pytest

from diffmill import examples
from diffmill.io import ProgramError, ProgramSetup, read_program
from diffmill.toolpath import Program


@pytest.fixture
def read(tmp_path):
    """Return the program of a text, with a data file beside it."""

    def read(text, suffix=".src", data="", *, tool_axis=None):
        (tmp_path / f"part{suffix}").write_text(text)
        if data:
            (tmp_path / "part.dat").write_text(data)
        setup = ProgramSetup(tool_axis=tool_axis)
        program = read_program(tmp_path / f"part{suffix}", setup=setup)
        assert isinstance(program, Program)
        return program

    return read


@pytest.fixture
def faults(read):
    """Return lines and words of the faults of a program that is refused."""

    def faults(*given, **more):
        with pytest.raises(ProgramError) as caught:
            read(*given, **more)
        return [(fault.line, fault.word) for fault in caught.value.faults]

    return faults


@pytest.fixture
def write(tmp_path):
    """Write the small example with more text; return its path."""

    def write(more):
        folder = tmp_path / "job"
        examples.copy_example("paper_small", folder)
        (job,) = folder.glob("*.toml")
        job.write_text(job.read_text() + more)
        return job

    return write
