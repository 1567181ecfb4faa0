"""Values that no machine has: refused with their key, or noted before a run."""

import numpy as np
import pytest

import diffmill as dm
from small_job import small_job

PROGRAM = "G21 G17 G90 G94\nG0 X-9 Y4 Z1\nG1 X-8 F6000\nM2\n"
CUTTER = 'kind = "flat"\ndiameter = "10 mm"\nteeth = 2'
MODES = """[[machine.modes]]
frequency = "20 Hz"
damping_ratio = 0.05
direction = [1, 0, 0]
stiffness = "1 N/um"
"""


@pytest.fixture
def load(tmp_path):
    """Load the small job with some text replaced."""

    def load(old="", new="", program=PROGRAM):
        (tmp_path / "part.ngc").write_text(program)
        text = small_job(CUTTER).replace("[robot]\nrigid = true\n", MODES)
        assert old in text
        file = tmp_path / "job.toml"
        file.write_text(text.replace(old, new, 1))
        return dm.load_job(file)

    return load


def test_a_plain_job_has_no_note_of_a_range(load):
    assert not [note for note in load().notes if "usual" in note]


@pytest.mark.parametrize(
    "found", ["inf", "nan", "-inf", "1e308", "1e12", "1e-200", "0"]
)
def test_a_direction_has_a_length_to_divide_by(load, found):
    with pytest.raises(dm.JobError, match=r"\[machine\] modes\.0 direction: found"):
        load("direction = [1, 0, 0]", f"direction = [{found}, 0, 0]")


def test_a_slow_spindle_needs_no_knots_of_its_own(load):
    # The knots that are the default, of 30 ms, lie closer than teeth of 37.5 ms.
    job = load('"8000 rpm"', '"800 rpm"')
    assert float(job.tooth_period) == pytest.approx(37.5e-3)
    stated = '"800 rpm"\n[correction]\nknot_spacing = "30 ms"'
    with pytest.raises(dm.JobError, match="knot_spacing: found 30 ms"):
        load('"8000 rpm"', stated)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('jerk = "1e-5 m/s^3"', r"\[program\] jerk: found 1e-05 m/s\^3"),
        ('smoothing = "1e6 s"', r"\[program\] smoothing: found 1e\+06 s"),
        ('smoothing = "1e19 s"', r"\[program\] smoothing: found 1e\+19 s"),
    ],
)
def test_a_motion_without_end_is_refused_before_its_rows_are_made(load, line, message):
    with pytest.raises(dm.JobError, match=message):
        load("[program]", f"[program]\n{line}")


def test_smoothing_counts_among_the_tooth_periods(load):
    stops = "".join(f"G1 X{x} F6000\n" for x in np.arange(300) % 2)
    with pytest.raises(dm.JobError, match="tooth periods; at most 1000000"):
        load(
            "[program]",
            '[program]\ncorner_tolerance = "0 mm"\nsmoothing = "30 s"',
            PROGRAM.replace("M2\n", f"{stops}M2\n"),
        )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"0.5 mm"', '"1 m"', r"\[stock\] spacing: found 1000 mm"),
        ('"0.5 mm"', '"1e300 mm"', r"\[stock\] spacing: found '1e300 mm'"),
        (
            "[program]",
            '[simulation]\nelement_height = "1e-9 mm"\n[program]',
            r"\[simulation\] element_height: found 1e-09 mm",
        ),
        (
            "[program]",
            '[correction]\nknot_spacing = "1e-10 s"\n[program]',
            r"\[correction\] knot_spacing: found 1e-07 ms",
        ),
    ],
)
def test_a_size_that_takes_all_memory_is_refused_with_its_key(load, old, new, message):
    with pytest.raises(dm.JobError, match=message):
        load(old, new)


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ("teeth = 2", 'teeth = 2\nflute_length = "8 m"', "[cutter] flute_length"),
        ("teeth = 2", "teeth = 60", "[cutter] teeth"),
        ('K_tc = "989.8 N/mm^2"', 'K_tc = "1e9 N/mm^2"', "[force] K_tc"),
        ('K_rc = "337.3', 'K_te = "3e6 N/mm"\nK_rc = "337.3', "[force] K_te"),
        ('"8000 rpm"', '"800000 rpm"', "[spindle] speed"),
        ("[program]", '[program]\nacceleration = "1000 m/s^2"', "[program] accelera"),
        ("[program]", '[program]\ncorner_tolerance = "1 km"', "[program] corner_tol"),
        ('frequency = "20 Hz"', 'frequency = "20 MHz"', "[machine] modes frequency"),
        ('"1 N/um"', '"1 N/m"', "[machine] modes stiffness"),
        ("0.05", "0.9", "[machine] modes damping_ratio"),
        ("[program]", '[correction]\nknot_spacing = "30 s"\n[program]', "[correction]"),
    ],
)
def test_a_value_far_from_any_machine_is_noted(load, old, new, place):
    (note,) = (note for note in load(old, new).notes if "are usual" in note)
    assert note.startswith(place)


def test_a_speed_of_the_program_is_noted_too(load):
    notes = load('speed = "8000 rpm"', "", PROGRAM.replace("G94", "G94 S800000 M3"))
    assert any("found '800000 rpm'" in note for note in notes.notes)


@pytest.mark.parametrize(("z", "is_in"), [(-1, True), (0, False), (1, False)])
def test_a_tool_that_starts_in_the_material_is_noted(load, z, is_in):
    program = f"G21 G17 G90 G94\nG0 X4 Y4 Z{z}\nG1 X14 F6000\nM2\n"
    notes = [note for note in load(program=program).notes if "starts in" in note]
    assert len(notes) == is_in
    assert all("1.000 mm deep" in note for note in notes)
