import math
import re
from typing import Any

import numpy as np
import pytest

from diffmill import JobError, io, load_job
from diffmill.config import job_precision
from diffmill.cutting import LinearEdgeLaw
from small_job import ARM, SLOT, SLOT_STOCK, job_text, problems_of, write_job

CUTTER = {"cutter.helix_angle": "30 deg", "cutter.flute_length": "22 mm"}
EDGES = {"force.K_te": "3.0 N/mm", "force.K_re": "15.4 N/mm", "force.K_ae": "4.5 N/mm"}
LIMITS = {
    "program.acceleration": "2 m/s^2",
    "program.rapid_feed": "200 mm/s",
    "program.corner_tolerance": "0.1 mm",
}
CSV = {"program.file": "path.csv"}


@pytest.fixture
def write(tmp_path):
    """Write a job with changed values beside its program; return its path."""
    rows = ["time_s,x_mm,y_mm,z_mm", "0,-6,4,-1", "0.05,-4,4,-1"]
    (tmp_path / "path.csv").write_text("\n".join(rows) + "\n")
    base = (SLOT_STOCK, CUTTER, EDGES, LIMITS)
    return lambda changes={}, **more: write_job(tmp_path, *base, changes, **more)


def test_a_program_may_be_as_large_as_its_reader_takes(write):
    text = f"({9000 * 'x'})\n" * 8000
    assert load_job(write(program=SLOT + text)).path.step_count > 1
    file = write()
    with (file.parent / "part.ngc").open("ab") as program:
        program.truncate(251_000_000)
    (problem,) = problems_of(file)
    assert "at most 250 MB" in problem


def test_values_in_si(write):
    job = load_job(write())
    assert job.name == "job"
    assert job.cutter.diameter == pytest.approx(0.010)
    assert job.cutter.helix_angle == pytest.approx(math.pi / 6)
    assert job.cutter.flute_count == 2
    assert job.spindle_speed == pytest.approx(8000 * 2 * math.pi / 60)
    assert job.tooth_period == pytest.approx(3.75e-3)
    assert isinstance(job.law, LinearEdgeLaw)
    assert job.law.K_tc == pytest.approx(989.8e6)
    assert job.law.K_re == pytest.approx(15400.0)
    assert float(job.stock.volume()) == pytest.approx(20e-3 * 10e-3 * 3e-3)
    assert job.robot is None
    assert job.source == write().read_text()
    assert job.program == SLOT
    # The path starts outside, cuts the slot and lifts.
    np.testing.assert_allclose(job.path.positions[0], [-6e-3, 5e-3, 1e-3], atol=1e-12)
    np.testing.assert_allclose(job.path.positions[-1], [20e-3, 5e-3, 1e-3], atol=1e-12)
    np.testing.assert_allclose(np.diff(job.path.time), 3.75e-3)


def test_defaults_of_the_simulation(write):
    settings = load_job(write()).simulation
    # 3.75 ms in steps below 0.5 ms, and 180 angles or more in multiples of 2 x 8.
    assert (settings.substeps, settings.angles) == (8, 192)
    # 1 mm deep, and 0.6 mm of room.
    assert settings.axial_depth == pytest.approx(1.6e-3)
    assert settings.precision == "float64"
    assert settings.integrator.name == "midpoint"
    assert settings.mode.name == "dynamic"


@pytest.mark.parametrize(
    ("change", "fewest"),
    [
        ({}, 180),
        ({"cutter.kind": "ball"}, 96),
        ({"cutter.runout": "5 um"}, 96),
        # The path goes deeper than the flutes.
        ({"cutter.flute_length": "1.2 mm"}, 180),
    ],
)
def test_defaults_that_are_written_out_are_allowed(write, change, fewest):
    file = write(change)
    wanted = load_job(file).simulation
    assert wanted.angles >= fewest
    table = {
        "angles": wanted.angles,
        "substeps": wanted.substeps,
        "element_height": f"{wanted.element_height} m",
        "axial_depth": f"{wanted.axial_depth:.7g} m",
    }
    found = load_job(write({**change, "simulation": table})).simulation
    assert found.angles == wanted.angles
    assert found.axial_depth == pytest.approx(wanted.axial_depth)
    (problem,) = problems_of(write({**change, "simulation.angles": 64}))
    assert "angles: found 64" in problem
    assert f"at least {fewest}" in problem
    (problem,) = problems_of(write({**change, "simulation.axial_depth": "23 mm"}))
    assert "axial_depth: found 23 mm" in problem


def test_a_record_in_place_of_a_job_is_refused(tmp_path):
    record = tmp_path / "slot1.txt"
    record.write_text("0.1\t5.0\n" * 150_000)
    with pytest.raises(JobError, match=r"more than 1 MB; a job file \(\.toml\) is req"):
        load_job(record)


def test_a_job_may_ask_for_the_chip_of_the_paper(write):
    chip = {"simulation.chip": "point_cloud"}
    settings = load_job(write(chip)).simulation
    assert settings.chip.name == "point_cloud"
    # Discs as high as the rays are apart.
    assert settings.element_height == pytest.approx(0.25e-3)
    assert load_job(write()).simulation.chip.name == "near_far"
    uneven = {"cutter.helix_angle": None, "cutter.runout": "5 um"}
    assert "[simulation] chip" in problems_of(write({**chip, **uneven}))[0]


def test_a_hollow_end_stands_upright(write):
    hollow: dict[str, Any] = {"cutter.helix_angle": None}
    hollow["cutter.dish_angle"] = "2 deg"
    hollow["simulation.bottom_edges"] = True
    dish_angle = load_job(write(hollow)).cutter.dish_angle
    assert dish_angle == pytest.approx(math.radians(2))
    (problem, *_) = problems_of(write({**hollow, "simulation.tool_tilt": True}))
    assert "dish_angle" in problem


@pytest.mark.parametrize(
    ("rpm", "substeps", "updates"),
    [
        # 60 / (15000 * 2) = 2 ms is 4 steps of exactly 0.5 ms.
        (15000, 4, 1),
        # 20 ms, at most 2 ms from look to look.
        (1500, 40, 10),
        (8000, 8, 1),
    ],
)
def test_substeps_and_looks_follow_the_tooth_period(write, rpm, substeps, updates):
    found = load_job(write({"spindle.speed": f"{rpm} rpm"})).simulation
    assert (found.substeps, found.updates_per_period) == (substeps, updates)


def test_flutes_shorter_than_the_path_is_deep_are_noted(write):
    job = load_job(write({"cutter.flute_length": "0.5 mm"}))
    assert job.simulation.axial_depth == pytest.approx(1.6e-3)
    assert any("shank_volume" in note for note in job.notes)


def write_leaning(file, degrees):
    """Write the recorded path of a job whose tool leans."""
    lean = math.radians(degrees)
    j, k = math.sin(lean), math.cos(lean)
    rows = [
        f"{0.01 * n},{x},5,-1,0,{j:.12f},{k:.12f}" for n, x in enumerate((-6, 0, 4))
    ]
    text = "\n".join(["time_s,x_mm,y_mm,z_mm,i,j,k", *rows])
    (file.parent / "path.csv").write_text(text + "\n")
    return file


@pytest.mark.parametrize("degrees", [0.0, 0.001, 0.005, 0.1])
def test_a_tool_that_leans_a_little_is_not_upright(write, degrees):
    """At 0.1 degrees its rim rises by some micrometres, at 0.005 by less than one."""
    job = load_job(write_leaning(write(CSV), degrees))
    assert bool(job.simulation.axes) == (degrees == 0.1)
    # G-code of X, Y and Z says where an upright tool goes, and no other.
    assert job.output.suffixes == ((".src",) if job.simulation.axes else (".ngc",))
    if job.simulation.axes:
        return
    assert io.write_gcode(job.path) and io.write_program(job.path, ".ngc")


@pytest.mark.parametrize(
    ("key", "value"), [("tool_tilt", True), ("bottom_edges", False)]
)
def test_switches_of_the_process(write, key, value):
    plain = load_job(write()).simulation
    # The machine is rigid.
    assert plain.axes == () and plain.has_bottom
    job = load_job(write({f"simulation.{key}": value}))
    assert bool(job.simulation.axes) == (key == "tool_tilt")
    assert job.simulation.has_bottom == (key != "bottom_edges")


def test_speed_from_the_program(write):
    program = SLOT.replace("G94", "G94 S6000 M3")
    job = load_job(write({"spindle.speed": None}, program=program))
    assert job.spindle_speed == pytest.approx(200 * math.pi)


def test_note_on_a_coarse_spacing(write):
    (of_end,) = load_job(write()).notes
    assert of_end.startswith("[force.bottom] is left out")
    note, *_ = load_job(write({"stock.spacing": "0.5 mm"})).notes
    assert "spacing is 0.5 mm" in note
    assert "0.25 mm" in note


def test_a_spline_has_an_effect_where_the_tool_tilts(write):
    job = load_job(write_leaning(write({**CSV, "output.blocks": "spline"}), 0.1))
    assert not any("[output]" in note for note in job.notes)


@pytest.mark.parametrize(
    ("idle", "needed"),
    [
        ({"output.blocks": "spline"}, {"output.formats": ["gcode", "krl"]}),
        ({"output.max_step": "50 um"}, {"output.stream_cycle": "4 ms"}),
    ],
)
def test_keys_of_the_output_without_effect_are_noted(write, idle, needed):
    note, _ = load_job(write(idle)).notes
    assert note.startswith(f"[output] {min(idle)[7:]}: without effect")
    (of_end,) = load_job(write({**idle, **needed})).notes
    assert of_end.startswith("[force.bottom]")


def test_recorded_path(write, tmp_path):
    file = write(CSV)
    rows = ["time_s,x_mm,y_mm,z_mm"]
    rows += [f"{0.01 * k},{-6 + 0.5 * k},5,-1" for k in range(40)]
    (tmp_path / "path.csv").write_text("\n".join(rows) + "\n")
    job = load_job(file)
    np.testing.assert_allclose(np.diff(job.path.positions[:, 0]), 50e-3 * 3.75e-3)
    # What the job states otherwise than it would be anyway.
    values = ("50 mm/s", "3 m/s^2", "0.1 s", "0.2 s")
    keys = ("feed", "acceleration", "smoothing", "joint_ramp")
    idle = {f"program.{key}": one for key, one in zip(keys, values, strict=True)}
    (note,) = load_job(write({**CSV, **idle})).notes
    assert note.startswith(f"[program] {', '.join(keys)}: without effect")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("tool", 1),
        ("block_delete", True),
        ("offsets", {"G55": ["1 mm", "0 mm", "0 mm"]}),
        ("tool_lengths", {"1": "80 mm"}),
        ("machine_zero", ["1 mm", "0 mm", "0 mm"]),
        ("reference_point", ["1 mm", "0 mm", "0 mm"]),
        ("second_reference_point", ["1 mm", "0 mm", "0 mm"]),
    ],
)
def test_what_a_recorded_path_has_no_use_for_is_refused(write, key, value):
    (problem,) = problems_of(write({**CSV, f"program.{key}": value}))
    assert problem.startswith(f"[program] {key}: found one, but a recorded path")


FAULTS = [
    ("cutter.diameter", 10, ("10", "a length")),
    ("cutter.diameter", "10", ("'10'", "a length")),
    ("cutter.diameter", "-10 mm", ("'-10 mm'", "above 0")),
    ("cutter.diameter", "10 m", ("found 10 m", "1 m at most")),
    ("cutter.diameter", "nan mm", ("'nan mm'", "finite")),
    ("cutter.diametre", "10 mm", ("unknown key", "perhaps diameter is meant")),
    ("cutter.diameter", None, ("found nothing", '"10 mm"')),
    ("cutter.kind", "cone", ("'cone'", "'flat'")),
    ("cutter.teeth", 0, ("0", "at least 1")),
    ("cutter.teeth", 2.0, ("2.0", "whole number")),
    ("cutter.teeth", True, ("True", "whole number")),
    ("cutter.helix_angle", "89 deg", ("89 deg", "80 deg")),
    ("spindle.speed", "8000 Hz", ("'8000 Hz'", "8000 rpm")),
    ("spindle.speed", "0 rpm", ("'0 rpm'", "above 0")),
    ("spindle.speed", "1 rpm", ("1 rpm", "at least")),
    ("spindle.speed", None, ("found nothing", '"8000 rpm"')),
    ("force.K_tc", "989.8 N/mm", ("'989.8 N/mm'", "N/mm^2")),
    ("force.K_te", "3.0 N", ("3.0 N", "N/mm")),
    ("stock.upper", ["20 mm", "10 mm"], ("10 mm", "3 values")),
    ("stock.upper", ["-20 mm", "10 mm", "0 mm"], ("-20 mm in x", "0 mm")),
    ("stock.spacing", "0 mm", ("'0 mm'", "above 0")),
    ("stock.spacing", "1 nm", ("GB", "half of the physical memory")),
    ("program.acceleration", "2 m/s", ("'2 m/s'", "2 m/s^2")),
    ("program.rapid_feed", "50 mm", ("'50 mm'", "a speed")),
    ("program.file", "none.ngc", ("'none.ngc'", "no such file")),
    ("program.file", "part.dxf", ("'part.dxf'", ".ngc")),
    ("program.file", "../part.ngc", ("'../part.ngc'", "outside")),
    ("program.file", "/etc/part.ngc", ("'/etc/part.ngc'", "outside")),
    ("robot", None, ("no such table", "rigid = true")),
    ("robot", {}, ("nothing", "reis_rv130_like")),
    ("robot.rigid", "yes", ("'yes'", "true or")),
    ("robot", {"rigid": True, **ARM}, ("model and rigid", "exactly one")),
    ("robot.model", "no_such", ("'no_such'", "reis_rv130_like")),
    ("robot.work_in_base", None, ("found nothing", "position")),
    ("robot.joint_stiffness", ["1e6 N*m/rad"], ("1 values", "one per joint")),
    ("robot.joint_damping", ["1 N*m"], ("'1 N*m'", "damping")),
    ("simulation.angles", 190, ("190", "multiple of teeth x substeps")),
    ("simulation.chip", "dexel", ("'dexel'", "'near_far'", "'point_cloud'")),
    ("simulation.mode", "static", ("'static'", "'dynamic'", "'quasistatic'")),
    ("simulation.integrator", "euler", ("'euler'", "'midpoint'", "'rk4'")),
    ("simulation.precision", "double", ("'double'", "'float64'")),
    ("correction.acceleration_factor", 0.5, ("found 0.5",)),
    ("correction.method", "magic", ("'magic'", "'gauss_newton'")),
]


@pytest.mark.parametrize(("key", "value", "parts"), FAULTS)
def test_one_fault(write, key, value, parts):
    table, _, name = key.partition(".")
    of_arm = name in ("model", "work_in_base", "joint_stiffness", "joint_damping")
    (problem,) = problems_of(
        write({"robot": ARM, key: value} if of_arm else {key: value})
    )
    assert f"[{table}] {name}".strip() in problem
    for part in parts:
        assert part in problem


def test_text_that_is_no_table_of_a_job(write):
    (problem,) = problems_of(write({"campaign": {}}))
    assert "campaign" in problem and "unknown table" in problem and "[stock]" in problem
    file = write()
    file.write_text(job_text().replace("[robot]", "[robot"))
    (problem,) = problems_of(file)
    assert "invalid TOML" in problem and "line" in problem


def test_all_faults_are_listed_at_once(write):
    wrong = {"cutter.teeth": -2, "stock.spacing": 0.25, "program.acceleration": "2 s"}
    program = SLOT.replace("G1 X20", "G5 X20").replace("M2", "M98\nM2")
    text = "\n".join(problems_of(write(wrong, program=program)))
    for part in ("teeth", "spacing", "acceleration", "G5", "line 4", "M98", "line 6"):
        assert part in text


def test_contradicting_speeds(write):
    (problem,) = problems_of(write(program="S9000 M3\n" + SLOT))
    for part in ("[spindle] speed", "8000 rpm", "S9000"):
        assert part in problem


def test_rapid_through_the_stock(write):
    program = SLOT.replace("G0 Z1\nM2", "G0 Y12\nG0 Z1\nM2").replace("X20", "X10")
    # Lifting the tool from where it should not be is reported, too.
    sideways, upward = problems_of(write(program=program))
    for part in ("[program] file", "line 5", "rapid", "(10.000, 5."):
        assert part in sideways
    found = re.search(r", (5\.\d+), -1\.000\) mm, (\d\.\d+) mm deep", sideways)
    assert found is not None
    # The end of the slot is a half circle: so far the tool is beyond it.
    beyond = float(found[1]) - 5.0
    assert beyond - 0.25 < float(found[2]) <= beyond
    assert "line 6" in upward


def test_the_end_of_a_peck_is_no_rapid_move_through_the_stock(write):
    """The row in which the tool turns back is rapid; the feed cut up to it."""
    holes = "G0 X10 Y5 Z2\nG83 X10 Y5 Z-2.5 R1 Q0.8 F240\nG80\nM2\n"
    load_job(write(program=f"G21 G17 G90 G94\n{holes}"))


def test_out_of_reach(write):
    far = {"robot": ARM, "robot.work_in_base.position": ["5525 mm", "-5 mm", "936 mm"]}
    (problem,) = problems_of(write(far))
    for part in ("[robot]", "reach", "time 0.000 s", "5519.0", "work_in_base", " rows"):
        assert part in problem
    away = float(problem.split("found is ")[1].split(" mm")[0])
    assert 2000 < away < 5000


def test_joint_limits(write):
    # Within arm's length, but the forearm would have to fold onto the upper arm.
    near = {"robot": ARM, "robot.work_in_base.position": ["325 mm", "-5 mm", "936 mm"]}
    text = "\n".join(problems_of(write(near)))
    assert "[robot]" in text
    assert "allowed is" in text or "reach" in text


def test_robot_within_reach(write):
    stiffness = [f"{i + 1}e6 N*m/rad" for i in range(6)]
    start = [f"{angle} deg" for angle in (0, 0, 15, 0, 75, 0)]
    own = {"joint_stiffness": stiffness, "joint_start": start}
    job = load_job(write({"robot": ARM | own}))
    assert job.robot is not None
    np.testing.assert_allclose(job.robot.joint_stiffness, 1e6 * np.arange(1, 7))
    np.testing.assert_allclose(job.T_base_work[:3, 3], [1.525, -0.005, 0.936])
    assert job.joint_start is not None
    np.testing.assert_allclose(job.joint_start, np.deg2rad([0, 0, 15, 0, 75, 0]))


def test_outside_only_on_request_and_not_by_a_link(write, tmp_path):
    moved = tmp_path / "jobs" / "job.toml"
    moved.parent.mkdir()
    moved.with_name("linked.ngc").symlink_to(tmp_path / "part.ngc")
    for name in ("linked.ngc", "../part.ngc"):
        moved.write_text(write({"program.file": name}).read_text())
        (problem,) = problems_of(moved)
        assert "outside" in problem
    assert load_job(moved, allow_outside=True).path.step_count > 2


def test_file_faults(tmp_path):
    with pytest.raises(JobError):
        load_job(tmp_path / "none.toml")
    with pytest.raises(JobError):
        load_job(tmp_path)
    (tmp_path / "job.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(JobError):
        load_job(tmp_path / "job.toml")
    (tmp_path / "part.ngc").write_text("%\nG0 X0\n")
    with pytest.raises(JobError, match=r"suffix '\.ngc' .* \(\.toml\) is required"):
        load_job(tmp_path / "part.ngc")


def test_precision_is_known_before_the_job(write, tmp_path):
    assert job_precision(write()) == "float64"
    file = write({"simulation.precision": "float32"})
    assert job_precision(file) == "float32"
    assert load_job(file).stock.origin.dtype == np.float32
    assert job_precision(tmp_path / "none.toml") == "float64"


def test_a_program_can_be_smoothed_and_of_a_recorded_path_it_is_told(write):
    key = {"program.smoothing": "30 ms"}
    plain = load_job(write())
    smooth = load_job(write(key))
    assert smooth.path.time[-1] > plain.path.time[-1] + 0.03
    notes = load_job(write({**key, **CSV})).notes
    assert any(note.startswith("[program] smoothing: without effect") for note in notes)


def test_a_corrected_command_may_accelerate_twice_as_much(write):
    factor = lambda changes: load_job(write(changes)).correction.acceleration_factor
    assert factor({}) == 2
    assert factor({"correction.acceleration_factor": math.inf}) == math.inf
    # What is stated instead, and what holds no limits.
    assert factor({"correction.max_acceleration": "9 m/s^2"}) == math.inf
    assert factor({"correction.method": "inverse_drive"}) == math.inf
    assert factor({**CSV, **dict.fromkeys(LIMITS)}) == math.inf
