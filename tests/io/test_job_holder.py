"""The tool holder of a job: its keys, its place in the notes, rapid moves."""

from typing import Any

import numpy as np
import pytest

from diffmill import load_job
from diffmill.sim import ToolContacts
from small_job import ARM, problems_of, write_job

JOB = {
    "cutter.diameter": "6 mm",
    "stock.lower": ["0 mm", "-10 mm", "-8 mm"],
    "stock.upper": ["20 mm", "10 mm", "0 mm"],
    "stock.spacing": "0.3 mm",
}
PROGRAM = """G21 G17 G90 G94
G0 X-16 Y0 Z2
G0 Z-5
G1 X{end} F6000
G0 {leave}
M2
"""
HOLDER: dict[str, Any] = {
    "overhang": "4 mm",
    "holder": [{"diameter": "16 mm", "length": "20 mm"}],
}


def holder(**keys):
    """Return the keys of a holder of one part, with others of the part."""
    part = HOLDER["holder"][0] | keys
    return HOLDER | {"holder": [{k: v for k, v in part.items() if v is not None}]}


@pytest.fixture
def write(tmp_path):
    """Write a job beside its program, in a folder of its own; return its path."""

    def write(cutter, end=10, leave="Z2", path=None, more=()):
        changes = {f"cutter.{key}": value for key, value in cutter.items()}
        if path is not None:
            (tmp_path / "path.csv").write_text(path)
            changes |= {"cutter.kind": "ball", "program.file": "path.csv"}
        program = PROGRAM.format(end=end, leave=leave)
        return write_job(tmp_path, JOB, changes, dict(more), program=program)

    return write


def test_sizes_in_si(write):
    parts = [
        {"diameter": "16 mm", "length": "9 mm"},
        {"diameter": "16 mm", "upper_diameter": "40 mm", "length": "11 mm"},
    ]
    job = load_job(write({"overhang": "30 mm", "holder": parts}))
    assert job.holder is not None
    assert job.holder.overhang == pytest.approx(30e-3)
    assert job.holder.radius == pytest.approx(20e-3)
    assert job.holder.length == pytest.approx(20e-3)
    assert job.holder.feet() == pytest.approx((30e-3, 39e-3))
    assert not any("holder" in note for note in job.notes)
    # Flutes of three diameters would fit.
    assert job.cutter.flute_length == pytest.approx(18e-3)
    assert load_job(write({})).holder is None


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"overhang": "30 mm"}, "holder: found overhang without holder"),
        ({"holder": HOLDER["holder"]}, "holder without overhang"),
        (HOLDER | {"flute_length": "5 mm"}, "at least the flute length, 5 mm"),
        (holder(length=None), 'tool axis, such as "40 mm"'),
        (holder(length=None, lenght="9 mm"), "diameter, upper_diameter, length"),
        (holder(diameter="-16 mm"), "[cutter] holder.0.diameter"),
        ({"overhang": "30 mm", "holder": []}, "[cutter] holder"),
    ],
)
def test_faults_are_named(write, keys, message):
    assert any(message in line for line in problems_of(write(keys)))


def test_two_overhangs_must_agree(write):
    bending = {"overhang": "5 mm", "young_modulus": "600 GPa"}
    # A speed without a unit ends the checks before the arm moves.
    more = {"spindle.speed": "8000", "robot": ARM | {"bending_tool": bending}}
    lines = problems_of(write(holder(length="9 mm"), more=more))
    (found,) = [line for line in lines if "[cutter] overhang" in line]
    assert "found 4 mm" in found and "5 mm" in found
    more["robot.bending_tool.overhang"] = "4 mm"
    lines = problems_of(write(holder(length="9 mm"), more=more))
    assert not any("[cutter] overhang" in line for line in lines)


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
    (line,) = problems_of(file)
    assert "line 5" in line and "of the tool holder" in line
    assert load_job(write({}, end=25, leave="Y-6")).holder is None


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
    lines = problems_of(write({}, path=leaning_path(1.2, -15)))
    assert all("rapid move through the stock" in line for line in lines)
    job = load_job(write({}, path=leaning_path(-1.2, -15)))
    assert not any("upright" in note for note in job.notes)
