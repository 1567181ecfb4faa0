"""Programs that tests read from a file."""

import pytest

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
