"""The tool holder of a job: its keys, its place in the notes, rapid moves."""

import numpy as np
import pytest

from diffmill import JobError, load_job
from diffmill.sim import ToolContacts

JOB = """
[cutter]
kind = "{kind}"
diameter = "6 mm"
teeth = 2
{cutter}
[spindle]
speed = "8000 rpm"
[force]
K_tc = "989.8 N/mm^2"
K_rc = "337.3 N/mm^2"
K_ac = "66.9 N/mm^2"
[stock]
lower = ["0 mm", "-10 mm", "-8 mm"]
upper = ["20 mm", "10 mm", "0 mm"]
spacing = "0.3 mm"
[program]
file = "{file}"
[robot]
rigid = true
"""
PROGRAM = """G21 G17 G90 G94
G0 X-16 Y0 Z2
G0 Z-5
G1 X{end} F6000
G0 {leave}
M2
"""
HOLDER = 'overhang = "4 mm"\nholder = [{ diameter = "16 mm", length = "20 mm" }]'


@pytest.fixture
def write(tmp_path):
    """Write a job beside its program, in a folder of its own; return its path."""

    def write(cutter, end=10, leave="Z2", path=None):
        file = "part.ngc" if path is None else "path.csv"
        text = PROGRAM.format(end=end, leave=leave) if path is None else path
        (tmp_path / file).write_text(text)
        kind = "flat" if path is None else "ball"
        (tmp_path / "job.toml").write_text(
            JOB.format(kind=kind, cutter=cutter, file=file)
        )
        return tmp_path / "job.toml"

    return write


def problems(file):
    with pytest.raises(JobError) as caught:
        load_job(file)
    return caught.value.problems


def test_sizes_in_si(write):
    parts = '{ diameter = "16 mm", length = "9 mm" }, { diameter = "16 mm", '
    parts += 'upper_diameter = "40 mm", length = "11 mm" }'
    job = load_job(write(f'overhang = "30 mm"\nholder = [{parts}]'))
    assert job.holder is not None
    assert job.holder.overhang == pytest.approx(30e-3)
    assert job.holder.radius == pytest.approx(20e-3)
    assert job.holder.length == pytest.approx(20e-3)
    assert job.holder.feet() == pytest.approx((30e-3, 39e-3))
    assert not any("holder" in note for note in job.notes)
    # Flutes of three diameters would fit.
    assert job.cutter.flute_length == pytest.approx(18e-3)
    assert load_job(write("")).holder is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('overhang = "30 mm"', "holder: found overhang without holder"),
        (HOLDER.split("\n")[1], "holder without overhang"),
        ('flute_length = "5 mm"\n' + HOLDER, "at least the flute length, 5 mm"),
        (HOLDER.replace(', length = "20 mm"', ""), 'tool axis, such as "40 mm"'),
        (HOLDER.replace("length", "lenght"), "diameter, upper_diameter, length"),
        (HOLDER.replace("16 mm", "-16 mm"), "[cutter] holder.0.diameter"),
        ('overhang = "30 mm"\nholder = []', "[cutter] holder"),
    ],
)
def test_faults_are_named(write, text, message):
    assert any(message in line for line in problems(write(text)))


def test_two_overhangs_must_agree(write):
    place = 'work_in_base = { position = ["1525 mm", "-5 mm", "936 mm"] }'
    bending = '[robot.bending_tool]\noverhang = "5 mm"\nyoung_modulus = "600 GPa"'
    holder = 'holder = [{ diameter = "16 mm", length = "9 mm" }]'
    text = write(f'overhang = "4 mm"\n{holder}').read_text()
    # A speed without a unit ends the checks before the arm moves.
    text = text.replace('"8000 rpm"', '"8000"')
    text = text.replace(
        "rigid = true", f'model = "reis_rv130_like"\n{place}\n{bending}'
    )
    file = write("")
    file.write_text(text)
    (found,) = [line for line in problems(file) if "[cutter] overhang" in line]
    assert "found 4 mm" in found and "5 mm" in found
    file.write_text(text.replace('5 mm"\nyoung', '4 mm"\nyoung'))
    assert not any("[cutter] overhang" in line for line in problems(file))


def test_a_holder_in_the_stock_is_noted(write):
    job = load_job(write(HOLDER))
    (note,) = [n for n in job.notes if n.startswith("[cutter] holder")]
    # The lower face stands 1 mm below the top, 8 mm ahead of the middle.
    assert "program line 4" in note and "up to 1.000 mm deep" in note
    assert "1.000 mm deep in what is left" in note
    contacts = ToolContacts.along(
        job.path, job.stock, job.cutter, job.holder, checks_rapids=False
    )
    x, _, z = job.path.positions.T
    found = contacts.holder_depth
    assert (found[(x > -7.4e-3) & (z < -4.9e-3)] > 0).all()
    assert not found[x < -8e-3].any()


def test_a_rapid_move_of_the_holder_through_stock_is_a_fault(write):
    # The tool is out of the block, its holder is not.
    file = write(HOLDER, end=25, leave="Y-6")
    (line,) = problems(file)
    assert "line 5" in line and "of the tool holder" in line
    assert load_job(write("", end=25, leave="Y-6")).holder is None


def leaning_path(tilt, y_mm):
    """Return rows of a recorded path: 12 mm along x in rapid, 4 mm below the top."""
    lines = ["time_s,x_mm,y_mm,z_mm,i,j,k,rapid"]
    j, k = np.sin(tilt), np.cos(tilt)
    lines += [
        f"{i * 3.75e-3:.5f},{4 + i},{y_mm},-4,0,{j:.12f},{k:.12f},{int(i > 0)}"
        for i in range(12)
    ]
    return "\n".join(lines) + "\n"


def test_a_leaning_tool_is_checked_in_its_true_pose(write):
    # 15 mm from the middle of the block, 5 mm from its face, and leaning over it.
    lines = problems(write("", path=leaning_path(1.2, -15)))
    assert all("rapid move through the stock" in line for line in lines)
    job = load_job(write("", path=leaning_path(-1.2, -15)))
    assert not any("upright" in note for note in job.notes)
