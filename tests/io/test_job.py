import math
import re

import numpy as np
import pytest

from diffmill import JobError, io, load_job
from diffmill.config import job_precision
from diffmill.cutting import LinearEdgeLaw

PROGRAM = """G21 G17 G90 G94
G0 X-6 Y5 Z1
G0 Z-1
G1 X20 F3000
G0 Z1
M2
"""
JOB = """
[cutter]
kind = "flat"
diameter = "10 mm"
teeth = 2
helix_angle = "30 deg"
flute_length = "22 mm"
[spindle]
speed = "8000 rpm"
[force]
K_tc = "989.8 N/mm^2"
K_rc = "337.3 N/mm^2"
K_ac = "66.9 N/mm^2"
K_te = "3.0 N/mm"
K_re = "15.4 N/mm"
K_ae = "4.5 N/mm"
[stock]
lower = ["0 mm", "0 mm", "-3 mm"]
upper = ["20 mm", "10 mm", "0 mm"]
spacing = "0.25 mm"
[program]
file = "part.ngc"
acceleration = "2 m/s^2"
rapid_feed = "200 mm/s"
corner_tolerance = "0.1 mm"
[robot]
rigid = true
"""
ROBOT = """model = "reis_rv130_like"
work_in_base = { position = ["1525 mm", "-5 mm", "936 mm"] }"""


@pytest.fixture
def write(tmp_path):
    """Write a job with replaced text beside its program; return its path."""

    def write(*changes, program=PROGRAM):
        text = JOB
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        (tmp_path / "job.toml").write_text(text)
        (tmp_path / "part.ngc").write_text(program)
        return tmp_path / "job.toml"

    return write


def problems_of(file, **options):
    before = sorted(file.parent.rglob("*"))
    with pytest.raises(JobError) as error:
        load_job(file, **options)
    assert sorted(file.parent.rglob("*")) == before
    assert str(file) in str(error.value)
    for problem in error.value.problems:
        assert problem in str(error.value)
    return error.value.problems


def test_a_program_may_be_as_large_as_its_reader_takes(write):
    text = f"({9000 * 'x'})\n" * 8000
    assert load_job(write(program=PROGRAM + text)).path.step_count > 1
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
    assert job.source == (write()).read_text()
    assert job.program == PROGRAM
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
    assert settings.integrator == "midpoint"
    assert settings.mode == "dynamic"


@pytest.mark.parametrize(
    ("change", "fewest"),
    [
        (('"flat"', '"flat"'), 180),
        (('"flat"', '"ball"'), 96),
        (('"22 mm"', '"22 mm"\nrunout = "5 um"'), 96),
        # The path goes deeper than the flutes.
        (('"22 mm"', '"1.2 mm"'), 180),
    ],
)
def test_defaults_that_are_written_out_are_allowed(write, change, fewest):
    file = write(change)
    wanted = load_job(file).simulation
    assert wanted.angles >= fewest
    table = f"""[simulation]
angles = {wanted.angles}
substeps = {wanted.substeps}
element_height = "{wanted.element_height} m"
axial_depth = "{wanted.axial_depth:.7g} m"
[robot]"""
    found = load_job(write(change, ("[robot]", table))).simulation
    assert found.angles == wanted.angles
    assert found.axial_depth == pytest.approx(wanted.axial_depth)
    coarse = ("[robot]", "[simulation]\nangles = 64\n[robot]")
    (problem,) = problems_of(write(change, coarse))
    assert "angles: found 64" in problem
    assert f"at least {fewest}" in problem
    deep = ("[robot]", '[simulation]\naxial_depth = "23 mm"\n[robot]')
    (problem,) = problems_of(write(change, deep))
    assert "axial_depth: found 23 mm" in problem


def test_a_job_may_ask_for_the_chip_of_the_paper(write):
    file = write(("[robot]", '[simulation]\nchip = "point_cloud"\n[robot]'))
    settings = load_job(file).simulation
    assert settings.chip == "point_cloud"
    # Discs as high as the rays are apart.
    assert settings.element_height == pytest.approx(0.25e-3)
    assert load_job(write()).simulation.chip == "near_far"
    file = write(
        ("[robot]", '[simulation]\nchip = "point_cloud"\n[robot]'),
        ('helix_angle = "30 deg"', 'runout = "5 um"'),
    )
    assert "[simulation] chip" in problems_of(file)[0]


def test_a_hollow_end_stands_upright(write):
    hollow = ('helix_angle = "30 deg"', 'dish_angle = "2 deg"')
    file = write(("[robot]", "[simulation]\nbottom_edges = true\n[robot]"), hollow)
    assert load_job(file).cutter.dish_angle == pytest.approx(math.radians(2))
    tilting = "[simulation]\nbottom_edges = true\ntool_tilt = true\n[robot]"
    assert "dish_angle" in problems_of(write(("[robot]", tilting), hollow))[0]


def test_exact_number_of_substeps(write):
    # 60 / (15000 * 2) = 2 ms is 4 steps of exactly 0.5 ms.
    job = load_job(write(('"8000 rpm"', '"15000 rpm"')))
    assert job.simulation.substeps == 4


def test_a_long_tooth_period_looks_up_the_stock_on_its_way(write):
    assert load_job(write()).simulation.updates_per_period == 1
    # 20 ms, at most 2 ms from look to look.
    job = load_job(write(('"8000 rpm"', '"1500 rpm"')))
    assert (job.simulation.substeps, job.simulation.updates_per_period) == (40, 10)


def test_flutes_shorter_than_the_path_is_deep_are_noted(write):
    job = load_job(write(('"22 mm"', '"0.5 mm"')))
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
    (file.parent / "part.csv").write_text(text + "\n")
    return file


@pytest.mark.parametrize("degrees", [0.0, 0.001, 0.005, 0.1])
def test_a_tool_that_leans_a_little_is_not_upright(write, degrees):
    """At 0.1 degrees its rim rises by some micrometres, at 0.005 by less than one."""
    job = load_job(write_leaning(write(("part.ngc", "part.csv")), degrees))
    assert bool(job.simulation.axes) == (degrees == 0.1)
    # G-code of X, Y and Z says where an upright tool goes, and no other.
    assert job.output.formats == ((".src",) if job.simulation.axes else (".ngc",))
    if job.simulation.axes:
        return
    assert io.write_gcode(job.path) and io.write_program(job.path, ".ngc")


@pytest.mark.parametrize(
    ("key", "value"), [("tool_tilt", "true"), ("bottom_edges", "false")]
)
def test_switches_of_the_process(write, key, value):
    plain = load_job(write()).simulation
    # The machine is rigid.
    assert plain.axes == () and plain.has_bottom
    job = load_job(write(("[robot]", f"[simulation]\n{key} = {value}\n[robot]")))
    assert bool(job.simulation.axes) == (key == "tool_tilt")
    assert job.simulation.has_bottom == (key != "bottom_edges")


def test_speed_from_the_program(write):
    file = write(
        ('speed = "8000 rpm"', ""), program=PROGRAM.replace("G94", "G94 S6000 M3")
    )
    assert load_job(file).spindle_speed == pytest.approx(200 * math.pi)


def test_note_on_a_coarse_spacing(write):
    (of_end,) = load_job(write()).notes
    assert of_end.startswith("[force.bottom] is left out")
    note, *_ = load_job(write(('"0.25 mm"', '"0.5 mm"'))).notes
    assert "spacing is 0.5 mm" in note
    assert "0.25 mm" in note


def test_a_spline_has_an_effect_where_the_tool_tilts(write):
    output = ("[robot]", '[output]\nblocks = "spline"\n[robot]')
    job = load_job(write_leaning(write(("part.ngc", "part.csv"), output), 0.1))
    assert not any("[output]" in note for note in job.notes)


@pytest.mark.parametrize(
    ("idle", "needed"),
    [
        ('blocks = "spline"', 'formats = ["gcode", "krl"]'),
        ('max_step = "50 um"', 'stream_cycle = "4 ms"'),
    ],
)
def test_keys_of_the_output_without_effect_are_noted(write, idle, needed):
    output = lambda *lines: ("[robot]", "\n".join(["[output]", *lines, "[robot]"]))
    note, _ = load_job(write(output(idle))).notes
    assert note.startswith(f"[output] {idle.split()[0]}: without effect")
    (of_end,) = load_job(write(output(idle, needed))).notes
    assert of_end.startswith("[force.bottom]")


def test_recorded_path(write, tmp_path):
    rows = ["time_s,x_mm,y_mm,z_mm"]
    rows += [f"{0.01 * k},{-6 + 0.5 * k},5,-1" for k in range(40)]
    (tmp_path / "path.csv").write_text("\n".join(rows) + "\n")
    job = load_job(write(('"part.ngc"', '"path.csv"')))
    np.testing.assert_allclose(np.diff(job.path.positions[:, 0]), 50e-3 * 3.75e-3)
    # What the job states otherwise than it would be anyway.
    feed = ("[robot]", 'feed = "50 mm/s"\n[robot]')
    limits = 'smoothing = "0.1 s"\njoint_ramp = "0.2 s"'
    other = ('"2 m/s^2"', f'"3 m/s^2"\n{limits}')
    (note,) = load_job(write(('"part.ngc"', '"path.csv"'), feed, other)).notes
    keys = "feed, acceleration, smoothing, joint_ramp"
    assert note.startswith(f"[program] {keys}: without effect")


@pytest.mark.parametrize(
    "line",
    [
        "tool = 1",
        "block_delete = true",
        'offsets = { G55 = ["1 mm", "0 mm", "0 mm"] }',
        'tool_lengths = { 1 = "80 mm" }',
        'machine_zero = ["1 mm", "0 mm", "0 mm"]',
        'reference_point = ["1 mm", "0 mm", "0 mm"]',
        'second_reference_point = ["1 mm", "0 mm", "0 mm"]',
    ],
)
def test_what_a_recorded_path_has_no_use_for_is_refused(write, tmp_path, line):
    rows = ["time_s,x_mm,y_mm,z_mm", "0,-6,4,-1", "0.05,-4,4,-1"]
    (tmp_path / "path.csv").write_text("\n".join(rows) + "\n")
    file = write(('"part.ngc"', '"path.csv"'), ("[robot]", f"{line}\n[robot]"))
    (problem,) = problems_of(file)
    key = line.split()[0]
    assert problem.startswith(f"[program] {key}: found one, but a recorded path")


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (
            ('diameter = "10 mm"', "diameter = 10"),
            ("[cutter] diameter", "10", "a length"),
        ),
        (
            ('diameter = "10 mm"', 'diameter = "10"'),
            ("[cutter] diameter", "'10'", "a length"),
        ),
        (
            ('diameter = "10 mm"', 'diameter = "-10 mm"'),
            ("[cutter] diameter", "'-10 mm'", "above 0"),
        ),
        (
            ('diameter = "10 mm"', 'diameter = "nan mm"'),
            ("[cutter] diameter", "'nan mm'", "finite"),
        ),
        (
            ('diameter = "10 mm"', 'diameter = "10 mm"\ndiametre = "10 mm"'),
            ("[cutter] diametre", "unknown key", "perhaps diameter is meant"),
        ),
        (
            ('diameter = "10 mm"', ""),
            ("[cutter] diameter", "found nothing", '"10 mm"'),
        ),
        (('kind = "flat"', 'kind = "cone"'), ("[cutter] kind", "'cone'", "'flat'")),
        (("teeth = 2", "teeth = 0"), ("[cutter] teeth", "0", "at least 1")),
        (("teeth = 2", "teeth = 2.0"), ("[cutter] teeth", "2.0", "whole number")),
        (("teeth = 2", "teeth = true"), ("[cutter] teeth", "True", "whole number")),
        (('"30 deg"', '"89 deg"'), ("[cutter] helix_angle", "89 deg", "80 deg")),
        (
            ('"8000 rpm"', '"8000 Hz"'),
            ("[spindle] speed", "'8000 Hz'", "8000 rpm"),
        ),
        (('"8000 rpm"', '"0 rpm"'), ("[spindle] speed", "'0 rpm'", "above 0")),
        (('"8000 rpm"', '"1 rpm"'), ("[spindle] speed", "1 rpm", "at least")),
        (
            ('speed = "8000 rpm"', ""),
            ("[spindle] speed", "found nothing", '"8000 rpm"'),
        ),
        (
            ('"989.8 N/mm^2"', '"989.8 N/mm"'),
            ("[force] K_tc", "'989.8 N/mm'", "N/mm^2"),
        ),
        (('K_te = "3.0 N/mm"', 'K_te = "3.0 N"'), ("[force] K_te", "3.0 N", "N/mm")),
        (
            ('upper = ["20 mm", "10 mm", "0 mm"]', 'upper = ["20 mm", "10 mm"]'),
            ("[stock] upper", "10 mm", "3 values"),
        ),
        (
            ('upper = ["20 mm",', 'upper = ["-20 mm",'),
            ("[stock] upper", "-20 mm in x", "0 mm"),
        ),
        (
            ('spacing = "0.25 mm"', 'spacing = "0 mm"'),
            ("[stock] spacing", "'0 mm'", "above 0"),
        ),
        (
            ('spacing = "0.25 mm"', 'spacing = "1 nm"'),
            ("[stock] spacing", "GB", "half of the physical memory"),
        ),
        (
            ('acceleration = "2 m/s^2"', 'acceleration = "2 m/s"'),
            ("[program] acceleration", "'2 m/s'", "2 m/s^2"),
        ),
        (
            ('rapid_feed = "200 mm/s"', 'rapid_feed = "50 mm"'),
            ("[program] rapid_feed", "'50 mm'", "a speed"),
        ),
        (
            ('"part.ngc"', '"none.ngc"'),
            ("[program] file", "'none.ngc'", "no such file"),
        ),
        (('"part.ngc"', '"part.dxf"'), ("[program] file", "'part.dxf'", ".ngc")),
        (
            ('"part.ngc"', '"../part.ngc"'),
            ("[program] file", "'../part.ngc'", "outside"),
        ),
        (
            ('"part.ngc"', '"/etc/part.ngc"'),
            ("[program] file", "'/etc/part.ngc'", "outside"),
        ),
        (
            ("[robot]\nrigid = true", ""),
            ("[robot]", "no such table", "rigid = true"),
        ),
        (("rigid = true", ""), ("[robot]", "nothing", "reis_rv130_like")),
        (("rigid = true", 'rigid = "yes"'), ("[robot] rigid", "'yes'", "true or")),
        (
            ("rigid = true", 'rigid = true\nmodel = "reis_rv130_like"'),
            ("[robot]", "model and rigid", "exactly one"),
        ),
        (
            ("rigid = true", 'model = "no_such"\n' + ROBOT.splitlines()[1]),
            ("[robot] model", "'no_such'", "reis_rv130_like"),
        ),
        (
            ("rigid = true", 'model = "reis_rv130_like"'),
            ("[robot] work_in_base", "found nothing", "position"),
        ),
        (
            ("rigid = true", ROBOT + '\njoint_stiffness = ["1e6 N*m/rad"]'),
            ("[robot] joint_stiffness", "1 values", "one per joint"),
        ),
        (
            ("rigid = true", ROBOT + '\njoint_damping = ["1 N*m"]'),
            ("[robot] joint_damping", "'1 N*m'", "damping"),
        ),
        (
            ("[robot]", "[simulation]\nangles = 190\n[robot]"),
            ("[simulation] angles", "190", "multiple of teeth x substeps"),
        ),
        (
            ("[robot]", '[simulation]\nchip = "dexel"\n[robot]'),
            ("[simulation] chip", "'dexel'", "'near_far'", "'point_cloud'"),
        ),
        (
            ("[robot]", '[simulation]\nmode = "static"\n[robot]'),
            ("[simulation] mode", "'static'", "'dynamic'", "'quasistatic'"),
        ),
        (
            ("[robot]", '[simulation]\nintegrator = "euler"\n[robot]'),
            ("[simulation] integrator", "'euler'", "'midpoint'", "'rk4'"),
        ),
        (
            ("[robot]", '[simulation]\nprecision = "double"\n[robot]'),
            ("[simulation] precision", "'double'", "'float64'"),
        ),
        (
            ("[robot]", '[correction]\nmethod = "magic"\n[robot]'),
            ("[correction] method", "'magic'", "'gauss_newton'"),
        ),
        (("[robot]", "[campaign]\n[robot]"), ("campaign", "unknown table", "[stock]")),
        (("[robot]", "[robot"), ("invalid TOML", "line")),
    ],
    ids=lambda value: value[-1] if isinstance(value, tuple) else None,
)
def test_one_fault(write, change, expected):
    problems = problems_of(write(change))
    assert len(problems) == 1
    for part in expected:
        assert part in problems[0]


def test_all_faults_are_listed_at_once(write):
    file = write(
        ("teeth = 2", "teeth = -2"),
        ('"0.25 mm"', "0.25"),
        ('"2 m/s^2"', '"2 s"'),
        program=PROGRAM.replace("G1 X20", "G5 X20").replace("M2", "M98\nM2"),
    )
    text = "\n".join(problems_of(file))
    for part in ("teeth", "spacing", "acceleration", "G5", "line 4", "M98", "line 6"):
        assert part in text


def test_contradicting_speeds(write):
    (problem,) = problems_of(write(program="S9000 M3\n" + PROGRAM))
    for part in ("[spindle] speed", "8000 rpm", "S9000"):
        assert part in problem


def test_rapid_through_the_stock(write):
    program = PROGRAM.replace("G0 Z1\nM2", "G0 Y12\nG0 Z1\nM2").replace("X20", "X10")
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


def test_out_of_reach(write):
    file = write(("rigid = true", ROBOT.replace("1525", "5525")))
    (problem,) = problems_of(file)
    for part in ("[robot]", "reach", "time 0.000 s", "5519.0", "work_in_base", " rows"):
        assert part in problem
    away = float(problem.split("found is ")[1].split(" mm")[0])
    assert 2000 < away < 5000


def test_joint_limits(write):
    # Within arm's length, but the forearm would have to fold onto the upper arm.
    file = write(("rigid = true", ROBOT.replace("1525", "325")))
    text = "\n".join(problems_of(file))
    assert "[robot]" in text
    assert "allowed is" in text or "reach" in text


def test_robot_within_reach(write):
    stiffness = ", ".join(f'"{i + 1}e6 N*m/rad"' for i in range(6))
    start = ", ".join(
        ["'0 deg'", "'0 deg'", "'15 deg'", "'0 deg'", "'75 deg'", "'0 deg'"]
    )
    job = load_job(
        write(
            (
                "rigid = true",
                f"{ROBOT}\njoint_stiffness = [{stiffness}]\njoint_start = [{start}]",
            )
        )
    )
    assert job.robot is not None
    np.testing.assert_allclose(job.robot.joint_stiffness, 1e6 * np.arange(1, 7))
    np.testing.assert_allclose(job.T_base_work[:3, 3], [1.525, -0.005, 0.936])
    assert job.joint_start is not None
    np.testing.assert_allclose(job.joint_start, np.deg2rad([0, 0, 15, 0, 75, 0]))


def test_outside_only_on_request(write, tmp_path):
    folder = tmp_path / "jobs"
    folder.mkdir()
    file = write(('"part.ngc"', '"../part.ngc"'))
    moved = folder / "job.toml"
    moved.write_text(file.read_text())
    (problem,) = problems_of(moved)
    assert "outside" in problem
    assert load_job(moved, allow_outside=True).path.step_count > 2


def test_link_to_the_outside(write, tmp_path):
    file = write()
    folder = tmp_path / "jobs"
    folder.mkdir()
    (folder / "job.toml").write_text(file.read_text())
    (folder / "part.ngc").symlink_to(tmp_path / "part.ngc")
    (problem,) = problems_of(folder / "job.toml")
    assert "outside" in problem


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
    file = write(("[robot]", '[simulation]\nprecision = "float32"\n[robot]'))
    assert job_precision(file) == "float32"
    assert load_job(file).stock.origin.dtype == np.float32
    assert job_precision(tmp_path / "none.toml") == "float64"


def test_a_program_can_be_smoothed_and_of_a_recorded_path_it_is_told(write, tmp_path):
    key = ("[program]", '[program]\nsmoothing = "30 ms"')
    plain = load_job(write())
    smooth = load_job(write(key))
    assert smooth.path.time[-1] > plain.path.time[-1] + 0.03
    rows = ["time_s,x_mm,y_mm,z_mm", "0,-6,4,-1", "0.05,-4,4,-1"]
    (tmp_path / "path.csv").write_text("\n".join(rows) + "\n")
    notes = load_job(write(key, ('"part.ngc"', '"path.csv"'))).notes
    assert any(note.startswith("[program] smoothing: without effect") for note in notes)


def test_a_corrected_command_may_accelerate_twice_as_much(write, tmp_path):
    factor = lambda file: load_job(file).correction.acceleration_factor
    table = ("[robot]", "[correction]\n{}\n[robot]")
    state = lambda line: (table[0], table[1].format(line))
    assert factor(write()) == 2
    assert factor(write(state("acceleration_factor = inf"))) == math.inf
    # What is stated instead, and what holds no limits.
    assert factor(write(state('max_acceleration = "9 m/s^2"'))) == math.inf
    assert factor(write(state('method = "inverse_drive"'))) == math.inf
    rows = ["time_s,x_mm,y_mm,z_mm", "0,-6,4,-1", "0.05,-4,4,-1"]
    (tmp_path / "path.csv").write_text("\n".join(rows) + "\n")
    lines = 'acceleration = "2 m/s^2"\nrapid_feed = "200 mm/s"\n'
    lines += 'corner_tolerance = "0.1 mm"\n'
    assert factor(write(('"part.ngc"', '"path.csv"'), (lines, ""))) == math.inf


def test_a_factor_of_the_acceleration_is_at_least_one(write):
    tables = ("[robot]", "[correction]\nacceleration_factor = {}\n[robot]")
    job = load_job(write((tables[0], tables[1].format(2))))
    assert job.correction.acceleration_factor == 2
    with pytest.raises(JobError, match=r"acceleration_factor: found 0\.5"):
        load_job(write((tables[0], tables[1].format(0.5))))
