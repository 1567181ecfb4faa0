"""Values that no machine has: refused with their key, or noted before a run."""

import numpy as np
import pytest

import diffmill as dm
from diffmill import examples
from small_job import FLANGE_SPRING, small_job

PROGRAM = "G21 G17 G90 G94\nG0 X-9 Y4 Z1\nG1 X-8 F6000\nM2\n"
CUTTER = 'kind = "flat"\ndiameter = "10 mm"\nteeth = 2'
MODES = """[[machine.modes]]
frequency = "20 Hz"
damping_ratio = 0.05
direction = [1, 0, 0]
stiffness = "1 N/um"
"""
BENDING_TOOL = """
[robot.bending_tool]
overhang = "40 mm"
shank_diameter = "10 mm"
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
        ("989.8 N/mm^2", "989.8 Pa", "[force] K_tc"),
        ("337.3 N/mm^2", "337.3 Pa", "[force] K_rc"),
        (
            "[program]",
            '[force.bottom]\nK_tc = "1 GPa"\nK_rc = "1 Pa"\nK_ac = "0 Pa"\n[program]',
            "[force] bottom K_rc",
        ),
        ('"1 N/um"', '"1e12 N/m"', "[machine] modes stiffness"),
        ('"20 Hz"', '"0.02 Hz"', "[machine] modes frequency"),
        ("0.05", "0.0", "[machine] modes damping_ratio"),
        ("0.05", "1e-6", "[machine] modes damping_ratio"),
        ("teeth = 2", 'teeth = 2\nrunout = "1e-9 mm"', "[cutter] runout"),
        ("teeth = 2", 'teeth = 2\nflute_length = "0.3 mm"', "[cutter] flute_length"),
        ("teeth = 2", 'teeth = 2\nhelix_angle = "0.001 deg"', "[cutter] helix_angle"),
        ("[program]", '[program]\nsmoothing = "1 us"', "[program] smoothing"),
        ("[program]", '[program]\nrapid_feed = "10 um/s"', "[program] rapid_feed"),
        ("[program]", '[program]\ncorner_tolerance = "1 nm"', "[program] corner_tol"),
        ("[program]", '[program]\ntool_lengths = { 1 = "1 km" }', "[program] tool_le"),
        (
            "[program]",
            '[program]\noffsets.G54 = ["0 m", "0 m", "0 m"]\n'
            'offsets.G55 = ["1 km", "0 m", "0 m"]',
            "[program] offsets G55",
        ),
        ("[program]", '[controller]\nlow_pass = "20 kHz"\n[program]', "[controller]"),
        ("[program]", '[controller]\ndead_time = "1 s"\n[program]', "[controller]"),
        (
            "[program]",
            '[controller]\ninterpolation_cycle = "1 s"\n[program]',
            "[controller]",
        ),
        ("[program]", '[output]\ntolerance = "5 mm"\n[program]', "[output] tolerance"),
        (
            "[program]",
            "[simulation]\nscatter = { force = 1e-6 }\n[program]",
            "[simulation] scatter force",
        ),
        ('"8000 rpm"', '"60 rpm"', "[spindle] speed"),
        ('"8000 rpm"', '"150000 rpm"', "[spindle] speed"),
    ],
)
def test_a_value_far_from_any_machine_is_noted(load, old, new, place):
    found = [note for note in load(old, new).notes if "are usual" in note]
    assert any(note.startswith(place) for note in found)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('K_rc = "337', 'K_rc = "-337'),
        ("K_rc", 'K_te = "-3 N/mm"\nK_rc'),
        ("K_rc", 'K_re = "-3 N/mm"\nK_rc'),
    ],
)
def test_a_coefficient_of_an_unusual_sign_is_noted(load, old, new):
    place = f"[force] {new.partition(' ')[0]}: found '-3"
    assert any(note.startswith(place) for note in load(old, new).notes)


def test_coefficients_that_are_interchanged_are_noted(load):
    notes = load('K_rc = "337.3 N/mm^2"', 'K_rc = "3373 N/mm^2"').notes
    assert any(note.startswith("[force] K_rc: 3.41 times K_tc") for note in notes)


@pytest.mark.parametrize(("z", "is_noted"), [(-1, True), (1, False)])
def test_a_feed_per_tooth_that_no_cutter_takes_is_noted(load, z, is_noted):
    program = f"G21 G17 G90 G94\nG0 X-9 Y4 Z{z}\nG1 X14 F6000\nM2\n"
    notes = load('"8000 rpm"', '"500 rpm"', program).notes
    assert any("feed per tooth is up to 6 mm" in note for note in notes) == is_noted


@pytest.mark.parametrize(("depth", "is_small"), [("0.2 mm", True), ("1 mm", False)])
def test_a_depth_less_than_that_of_the_path_is_noted(load, depth, is_small):
    program = PROGRAM.replace("X-9 Y4 Z1", "X-9 Y4 Z-1").replace("X-8", "X14")
    more = f'[simulation]\naxial_depth = "{depth}"\n[program]'
    notes = load("[program]", more, program).notes
    assert any("[simulation] axial_depth: found" in n for n in notes) == is_small


def test_a_line_of_a_program_is_no_negative_number(load):
    section = "[correction]\nweight = [{ lines = [-10, 20], value = 2 }]\n[program]"
    with pytest.raises(dm.JobError, match=r"weight.*lines"):
        load("[program]", section)


def test_a_speed_of_the_program_is_noted_too(load):
    notes = load('speed = "8000 rpm"', "", PROGRAM.replace("G94", "G94 S800000 M3"))
    assert any("found '800000 rpm'" in note for note in notes.notes)


@pytest.mark.parametrize(("z", "is_in"), [(-1, True), (0, False), (1, False)])
def test_a_tool_that_starts_in_the_material_is_noted(load, z, is_in):
    program = f"G21 G17 G90 G94\nG0 X4 Y4 Z{z}\nG1 X14 F6000\nM2\n"
    notes = [note for note in load(program=program).notes if "starts in" in note]
    assert len(notes) == is_in
    assert all("1.000 mm deep" in note for note in notes)


@pytest.fixture(scope="module")
def soft(tmp_path_factory):
    """Return the notes of an example with a soft flange and a bending tool."""
    job = examples.copy_example("paper_small", tmp_path_factory.mktemp("soft"))
    job.write_text(job.read_text() + FLANGE_SPRING + BENDING_TOOL)
    return lambda changes: dm.load_job(job, changes=changes).notes


def test_a_usual_flange_and_tool_have_no_note(soft):
    assert not [note for note in soft({}) if "usual" in note]


@pytest.mark.parametrize(
    ("key", "value", "place"),
    [
        ("flange_spring.rotary_stiffness.1", "1e12 N*m/rad", "[robot] flange_spring"),
        ("flange_spring.mass", "30 t", "[robot] flange_spring mass"),
        ("flange_spring.inertia.1", "0.75 kg*mm^2", "[robot] flange_spring inertia"),
        ("flange_spring.inertia.1", "750 kg*m^2", "[robot.flange_spring] inertia"),
        ("bending_tool.overhang", "400 mm", "[robot.bending_tool] overhang: 40 times"),
        ("bending_tool.shank_diameter", "0.1 mm", "[robot.bending_tool] shank_diamet"),
        ("bending_tool.flute_share", 0.008, "[robot] bending_tool flute_share"),
        ("joint_stiffness.1", "1e12 N*m/rad", "[robot] joint_stiffness"),
    ],
)
def test_a_spring_or_a_tool_that_no_robot_has_is_noted(soft, key, value, place):
    changes = {f"robot.{key}": value, "robot.flange_spring.in_last_link": False}
    if key.startswith("joint_stiffness"):
        rest = ["4e6 N*m/rad", "4e6 N*m/rad", "1e6 N*m/rad", "1e6 N*m/rad"]
        changes = {"robot.joint_stiffness": [value, *rest, "1e6 N*m/rad"]}
    assert any(note.startswith(place) for note in soft(changes))
