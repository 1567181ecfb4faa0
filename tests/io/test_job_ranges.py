"""Values that no machine has: refused with their key, or noted before a run."""

from typing import Any

import numpy as np
import pytest

import diffmill as dm
from diffmill import examples
from small_job import FLANGE_SPRING, PROGRAM, problems_of, write_job

MODE: dict[str, Any] = {"frequency": "20 Hz", "damping_ratio": 0.05}
MODE |= {"direction": [1, 0, 0], "stiffness": "1 N/um"}
BENDING_TOOL = """
[robot.bending_tool]
overhang = "40 mm"
shank_diameter = "10 mm"
"""


def mode(**keys):
    """Return the change that gives the machine other values of its mode."""
    return {"machine": {"modes": [MODE | keys]}}


@pytest.fixture
def write(tmp_path):
    """Write the small job of a machine of one mode with some values changed."""

    def write(changes=(), program=PROGRAM):
        return write_job(
            tmp_path, {"robot": None, **mode()}, dict(changes), program=program
        )

    return write


@pytest.fixture
def load(write):
    return lambda *given: dm.load_job(write(*given))


def test_a_plain_job_has_no_note_of_a_range(load):
    assert not [note for note in load().notes if "usual" in note]


@pytest.mark.parametrize("found", [np.inf, np.nan, -np.inf, 1e308, 1e12, 1e-200, 0])
def test_a_direction_has_a_length_to_divide_by(write, found):
    (problem,) = problems_of(write(mode(direction=[found, 0, 0])))
    assert "[machine] modes.0 direction: found" in problem


def test_a_slow_spindle_needs_no_knots_of_its_own(load, write):
    # The knots that are the default, of 30 ms, lie closer than teeth of 37.5 ms.
    slow = {"spindle.speed": "800 rpm"}
    assert float(load(slow).tooth_period) == pytest.approx(37.5e-3)
    problems = problems_of(write(slow | {"correction.knot_spacing": "30 ms"}))
    assert any("knot_spacing: found 30 ms" in problem for problem in problems)


@pytest.mark.parametrize(
    ("key", "value", "found"),
    [
        # Motions without end, which are refused before their rows are made.
        ("program.jerk", "1e-5 m/s^3", "1e-05 m/s^3"),
        ("program.smoothing", "1e6 s", "1e+06 s"),
        ("program.smoothing", "1e19 s", "1e+19 s"),
        # Sizes that would take all memory.
        ("stock.spacing", "1 m", "1000 mm"),
        ("stock.spacing", "1e300 mm", "'1e300 mm'"),
        ("simulation.element_height", "1e-9 mm", "1e-09 mm"),
        ("correction.knot_spacing", "1e-10 s", "1e-07 ms"),
    ],
)
def test_a_value_that_no_run_ends_with_is_refused_with_its_key(
    write, key, value, found
):
    table, name = key.split(".")
    problems = problems_of(write({key: value}))
    assert any(f"[{table}] {name}: found {found}" in problem for problem in problems)


def test_smoothing_counts_among_the_tooth_periods(write):
    stops = "".join(f"G1 X{x} F6000\n" for x in np.arange(300) % 2)
    changes = {"program.corner_tolerance": "0 mm", "program.smoothing": "30 s"}
    problems = problems_of(write(changes, PROGRAM.replace("M2\n", f"{stops}M2\n")))
    assert any("tooth periods; at most 1000000" in problem for problem in problems)


ZERO, FAR = ["0 m", "0 m", "0 m"], ["1 km", "0 m", "0 m"]
BOTTOM = {"K_tc": "1 GPa", "K_rc": "1 Pa", "K_ac": "0 Pa"}


@pytest.mark.parametrize(
    ("changes", "place"),
    [
        ({"cutter.flute_length": "8 m"}, "[cutter] flute_length"),
        ({"cutter.teeth": 60}, "[cutter] teeth"),
        ({"force.K_tc": "1e9 N/mm^2"}, "[force] K_tc"),
        ({"force.K_te": "3e6 N/mm"}, "[force] K_te"),
        ({"spindle.speed": "800000 rpm"}, "[spindle] speed"),
        ({"program.acceleration": "1000 m/s^2"}, "[program] acceleration"),
        ({"program.corner_tolerance": "1 km"}, "[program] corner_tolerance"),
        (mode(frequency="20 MHz"), "[machine] modes frequency"),
        (mode(stiffness="1 N/m"), "[machine] modes stiffness"),
        (mode(damping_ratio=0.9), "[machine] modes damping_ratio"),
        ({"correction.knot_spacing": "30 s"}, "[correction]"),
        ({"force.K_tc": "989.8 Pa"}, "[force] K_tc"),
        ({"force.K_rc": "337.3 Pa"}, "[force] K_rc"),
        ({"force.bottom": BOTTOM}, "[force] bottom K_rc"),
        (mode(stiffness="1e12 N/m"), "[machine] modes stiffness"),
        (mode(frequency="0.02 Hz"), "[machine] modes frequency"),
        (mode(damping_ratio=0.0), "[machine] modes damping_ratio"),
        (mode(damping_ratio=1e-6), "[machine] modes damping_ratio"),
        ({"cutter.runout": "1e-9 mm"}, "[cutter] runout"),
        ({"cutter.flute_length": "0.3 mm"}, "[cutter] flute_length"),
        ({"cutter.helix_angle": "0.001 deg"}, "[cutter] helix_angle"),
        ({"program.smoothing": "1 us"}, "[program] smoothing"),
        ({"program.rapid_feed": "10 um/s"}, "[program] rapid_feed"),
        ({"program.corner_tolerance": "1 nm"}, "[program] corner_tolerance"),
        ({"program.tool_lengths": {"1": "1 km"}}, "[program] tool_lengths"),
        ({"program.offsets": {"G54": ZERO, "G55": FAR}}, "[program] offsets G55"),
        ({"controller.low_pass": "20 kHz"}, "[controller]"),
        ({"controller.dead_time": "1 s"}, "[controller]"),
        ({"controller.interpolation_cycle": "1 s"}, "[controller]"),
        ({"output.tolerance": "5 mm"}, "[output] tolerance"),
        ({"simulation.scatter": {"force": 1e-6}}, "[simulation] scatter force"),
        ({"spindle.speed": "60 rpm"}, "[spindle] speed"),
        ({"spindle.speed": "150000 rpm"}, "[spindle] speed"),
    ],
)
def test_a_value_far_from_any_machine_is_noted(load, changes, place):
    found = [note for note in load(changes).notes if "are usual" in note]
    assert any(note.startswith(place) for note in found)


@pytest.mark.parametrize(
    ("key", "value"),
    [("K_rc", "-337.3 N/mm^2"), ("K_te", "-3 N/mm"), ("K_re", "-3 N/mm")],
)
def test_a_coefficient_of_an_unusual_sign_is_noted(load, key, value):
    place = f"[force] {key}: found '-3"
    notes = load({f"force.{key}": value}).notes
    assert any(note.startswith(place) for note in notes)


def test_coefficients_that_are_interchanged_are_noted(load):
    notes = load({"force.K_rc": "3373 N/mm^2"}).notes
    assert any(note.startswith("[force] K_rc: 3.41 times K_tc") for note in notes)


@pytest.mark.parametrize(("z", "is_noted"), [(-1, True), (1, False)])
def test_a_feed_per_tooth_that_no_cutter_takes_is_noted(load, z, is_noted):
    program = f"G21 G17 G90 G94\nG0 X-9 Y4 Z{z}\nG1 X14 F6000\nM2\n"
    notes = load({"spindle.speed": "500 rpm"}, program).notes
    assert any("feed per tooth is up to 6 mm" in note for note in notes) == is_noted


@pytest.mark.parametrize(("depth", "is_small"), [("0.2 mm", True), ("1 mm", False)])
def test_a_depth_less_than_that_of_the_path_is_noted(load, depth, is_small):
    program = PROGRAM.replace("X-9 Y4 Z1", "X-9 Y4 Z-1").replace("X-8", "X14")
    notes = load({"simulation.axial_depth": depth}, program).notes
    assert any("[simulation] axial_depth: found" in n for n in notes) == is_small


def test_a_line_of_a_program_is_no_negative_number(write):
    weight = [{"lines": [-10, 20], "value": 2}]
    (problem,) = problems_of(write({"correction.weight": weight}))
    assert "weight" in problem and "lines" in problem


def test_a_speed_of_the_program_is_noted_too(load):
    program = PROGRAM.replace("G94", "G94 S800000 M3")
    notes = load({"spindle.speed": None}, program).notes
    assert any("found '800000 rpm'" in note for note in notes)


@pytest.mark.parametrize(("z", "is_in"), [(-1, True), (0, False), (1, False)])
def test_a_tool_that_starts_in_the_material_is_noted(load, z, is_in):
    program = f"G21 G17 G90 G94\nG0 X4 Y4 Z{z}\nG1 X14 F6000\nM2\n"
    notes = [note for note in load({}, program).notes if "starts in" in note]
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
