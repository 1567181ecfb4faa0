"""Files that are damaged or made to harm: one clear message each, in little time."""

import time

import numpy as np
import pytest
import xarray

import diffmill
from diffmill import config, io, robot, workpiece
from small_job import write_job

IDENTIFICATION = """kind = "force_records"
[cutter]
diameter = "10 mm"
teeth = 2
[spindle]
speed = "6000 rpm"
[cut]
axial_depth = "2 mm"
[[record]]
file = "cut.txt"
feed_per_tooth = "0.05 mm"
"""
ARM = """name = "arm"
[[elements]]
kind = "revolute"
name = "turn"
[[elements]]
kind = "tool"
"""
# Processor time that reading a small file may take [s].
QUICK = 5.0
READERS = {
    "job": lambda file: diffmill.load_job(file),
    "identification": lambda file: config.load_identification(file),
    "robot": lambda file: robot.load(file),
}


def message_of(read, file, kind: type[ValueError] = ValueError) -> str:
    """Return the message with which a file is refused, in little time."""
    begin = time.process_time()
    with pytest.raises(kind) as error:
        read(file)
    assert time.process_time() - begin < QUICK
    message = str(error.value)
    assert str(file.name) in message
    assert len(message) < 5000
    return message


def record(count=400, rate=1000.0) -> list[str]:
    """Return the rows of a record with few digits in its time."""
    time = np.arange(count) / rate
    return [f"{t:.3f};{np.sin(200 * t):.3f};1.0;2.0" for t in time]


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("a = " + "[" * 20_000, "nested deeper than 50"),
        ("a = " + "[" * 400 + "]" * 400, "nested deeper than 50"),
        ("a = " + "{ b = " * 20_000, "nested deeper than 50"),
        ("a." * 2_000 + "b = 1", "more than 50 parts"),
        ("a." * 400_000 + "b = 1", "more than 50 parts"),
        ("[" + "'a' . " * 2_000 + "b]", "more than 50 parts"),
        ("a = " + "7" * 60, "more than 64 bits"),
        ("a = " + "7" * 100_000, "invalid TOML"),
        ("a = ", "invalid TOML"),
        (b"\xff\xfe a = 1", "invalid TOML"),
    ],
)
def test_toml_that_no_reader_endures(tmp_path, reader, text, found):
    file = tmp_path / "file.toml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    assert found in message_of(READERS[reader], file)


@pytest.mark.parametrize(
    ("key", "value", "found"),
    [
        ("cutter.diameter", "1e300 mm", "[cutter] diameter: found '1e300 mm'"),
        ("correction.wall_weight", int("7" * 60), "more than 64 bits"),
        ("program.acceleration", "1e-12 m/s^2", "tooth periods; at most"),
        ("spindle.speed", "1e19 rpm", "tooth periods; at most"),
        ("program.file", "loop.ngc", "no such file"),
        ("cutter.diameter", "x" * 100_000 + " mm", "a text of 100003 characters"),
        ("x" * 100_000, {}, "unknown table or key"),
    ],
)
def test_jobs(tmp_path, key, value, found):
    (tmp_path / "loop.ngc").symlink_to("loop.ngc")
    file = write_job(tmp_path, {key: value})
    assert found in message_of(diffmill.load_job, file, diffmill.JobError)


def test_a_loop_of_links_is_no_file(tmp_path):
    (tmp_path / "job.toml").symlink_to("job.toml")
    assert "no such file" in message_of(diffmill.load_job, tmp_path / "job.toml")
    (tmp_path / "out").symlink_to("out")
    with pytest.raises((ValueError, OSError)):
        io.write_results(tmp_path / "out", xarray.Dataset())


@pytest.mark.parametrize("kind", ["[]", "{}", "1", "[[1]]", "true"])
def test_the_kind_of_an_identification_is_a_text(tmp_path, kind):
    file = tmp_path / "file.toml"
    file.write_text(IDENTIFICATION.replace('"force_records"', kind))
    assert "but one of" in message_of(config.load_identification, file)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("G1 X1 F100\n" + "Q" * 200_000, "the line has 200000 characters"),
        ("G1 X1 F100\n" + "(" * 200_000, "the line has 200000 characters"),
        ("G1 X1 F100 Q1\n" * 300_000, "further faults are not listed"),
    ],
)
def test_programs(tmp_path, text, found):
    file = tmp_path / "part.ngc"
    file.write_text(text)
    assert found in message_of(io.read_program, file)


def test_many_spindle_speeds_are_one_fault(tmp_path):
    rows = "".join(f"S{k}\n" for k in range(1, 3_001))
    file = write_job(tmp_path, program=f"G21 G90 G94\n{rows}G1 X20 F3000\nM2\n")
    message = message_of(diffmill.load_job, file)
    assert "S1, S2," in message
    assert "one speed is allowed" in message


@pytest.mark.parametrize("cell", ["9" * 400, "1e308", "-1e300", "3e9"])
@pytest.mark.parametrize("column", ["x_mm", "line"])
def test_paths(tmp_path, column, cell):
    rows = [["0", "0", "0", "0", "1"], ["0.01", "1", "0", "0", "2"]]
    names = ["time_s", "x_mm", "y_mm", "z_mm", "line"]
    rows[1][names.index(column)] = cell
    file = tmp_path / "path.csv"
    file.write_text("\n".join(",".join(row) for row in [names, *rows]))
    message = message_of(io.read_path_csv, file, io.ProgramError)
    assert "line 3" in message


@pytest.mark.parametrize(
    "line",
    [
        "sampl" + "_" * 100_000,
        "sampl" * 20_000,
        "dt " + "(" + " " * 100_000,
        "Fx" + " " * 100_000 + "[",
        "Fx [" + " " * 100_000,
        "a" + " in" * 50_000,
        '"' + "x" * 300_000 + '"',
        "7" * 300_000,
        "1;" * 3_000,
    ],
)
@pytest.mark.parametrize("place", ["before", "names", "between"])
def test_records_with_one_long_line(tmp_path, line, place):
    rows = ["t [s];Fx [N];Fy [N];Fz [N]", *record()]
    if place == "names":
        rows[0] = f"t [s];{line};Fy [N];Fz [N]"
    else:
        rows.insert({"before": 0, "between": 200}[place], line)
    file = tmp_path / "cut.txt"
    file.write_text("\n".join(rows))
    begin = time.process_time()
    try:
        found = io.load_record(file)
    except io.RecordError as error:
        assert len(str(error)) < 5000
    else:
        assert len(found.time) == 400
    assert time.process_time() - begin < QUICK


@pytest.mark.parametrize("row", [0, 3, 99])
def test_a_flipped_bit_in_the_time_of_a_record(tmp_path, row):
    rows = record(100)
    file = tmp_path / "cut.txt"
    for digit in range(5):
        for bit in (0, 3, 5):
            flipped = chr(ord(rows[row][digit]) ^ (1 << bit))
            broken = rows[row][:digit] + flipped + rows[row][digit + 1 :]
            text = ["t;Fx;Fy;Fz", *rows[:row], broken, *rows[row + 1 :]]
            file.write_text("\n".join(text), encoding="latin-1")
            # Whatever the row is taken for, the others tell the rate.
            assert io.load_record(file).rate == pytest.approx(1000.0, rel=0.01)


def test_stamps_that_tell_no_rate(tmp_path):
    # Whole seconds, and one of them with a flipped bit.
    rows = [f"{9000 if k == 20 else 1000};{k};1.0;2.0" for k in range(40)]
    file = tmp_path / "cut.txt"
    file.write_text("\n".join(["t;Fx;Fy;Fz", *rows]))
    message = message_of(io.load_record, file, io.RecordError)
    assert "too few digits to show the sampling rate" in message
    assert io.load_record(file, {"time": None}, 100.0).rate == pytest.approx(100.0)


def test_a_damaged_mesh_prints_nothing(tmp_path, capfd):
    file = tmp_path / "part.stl"
    file.write_bytes(b"solid part\nfacet normal 0 0 x\n" + b"\0" * 1000)
    assert "part.stl" in message_of(
        lambda one: workpiece.from_mesh(one, 1e-3), file, workpiece.StockFileError
    )
    assert capfd.readouterr() == ("", "")
