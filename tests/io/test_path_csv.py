"""Paths as CSV: units, round trips and refusals."""

import numpy as np
import pytest

from diffmill.io import ProgramError, read_path_csv, write_path_csv
from diffmill.toolpath import Path


def example(rows=6):
    rng = np.random.default_rng(0)
    axes = rng.standard_normal((rows, 3))
    return Path(
        time=0.00375 * np.arange(rows),
        positions=0.1 * rng.standard_normal((rows, 3)),
        axes=axes / np.linalg.norm(axes, axis=1, keepdims=True),
        is_rapid=np.arange(rows) % 2 == 1,
        line=np.arange(rows, dtype=np.int32) + 7,
    )


def test_round_trip(tmp_path):
    path = example()
    file = tmp_path / "path.csv"
    file.write_text(write_path_csv(path))
    back = read_path_csv(file)
    np.testing.assert_allclose(back.time, path.time, atol=1e-12)
    np.testing.assert_allclose(back.positions, path.positions, atol=1e-12)
    np.testing.assert_allclose(back.axes, path.axes, atol=1e-11)
    np.testing.assert_array_equal(back.is_rapid, path.is_rapid)
    np.testing.assert_array_equal(back.line, path.line)


def test_written_header_begins_as_promised():
    header, first, second = write_path_csv(example()).splitlines()[:3]
    assert header.startswith("time_s,x_mm,y_mm,z_mm,rapid,feed_mm_per_min,i,j,k")
    assert first.split(",")[5] == "0.000000"
    path = example()
    speed = np.linalg.norm(np.diff(path.positions, axis=0)[0]) / 0.00375
    assert float(second.split(",")[5]) == pytest.approx(speed * 6e4, rel=1e-9)


@pytest.fixture
def read(tmp_path):
    """Return a path from the text of a file."""

    def read(text):
        file = tmp_path / "path.csv"
        file.write_bytes(text.encode())
        return read_path_csv(file)

    return read


@pytest.mark.parametrize(
    ("header", "time_scale", "length_scale"),
    [
        ("time_s,x_mm,y_mm,z_mm", 1.0, 1e-3),
        ("time_ms,x_m,y_m,z_m", 1e-3, 1.0),
        ("time_min,x_in,y_in,z_in", 60.0, 0.0254),
        ("Time [ms],X [ft],Y [ft],Z [ft]", 1e-3, 0.3048),
        ("Time_s, X_um, Y_um, Z_um", 1.0, 1e-6),
    ],
)
@pytest.mark.parametrize("delimiter", [",", ";"])
def test_units_of_the_header(read, header, time_scale, length_scale, delimiter):
    text = f"{header}\r\n1,2,3,4\r\n\r\n2.5,-1,+.5,1e2\r\n".replace(",", delimiter)
    path = read(text)
    begin = 1 if "[" in header else 0
    np.testing.assert_allclose(path.time, time_scale * (np.array([1, 2.5]) - begin))
    expected = length_scale * np.array([[2, 3, 4], [-1, 0.5, 100]])
    np.testing.assert_allclose(path.positions, expected)
    np.testing.assert_array_equal(path.axes, [[0, 0, 1]] * 2)
    np.testing.assert_array_equal(path.line, [2, 4])
    assert not np.any(path.is_rapid)


def test_columns_in_any_order_and_comments(read):
    text = "# recorded\nz_mm,rapid,y_m,time_s,x_in\n1,0,2,0,3\n4,1,5,1,6\n"
    path = read(text)
    np.testing.assert_allclose(
        path.positions, [[3 * 0.0254, 2, 1e-3], [6 * 0.0254, 5, 4e-3]]
    )
    np.testing.assert_array_equal(path.is_rapid, [False, True])


HEADER = "time_s,x_mm,y_mm,z_mm"


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ["empty"]),
        (HEADER, ["0 rows", "needed are 2"]),
        (f"{HEADER}\n0,0,0,0\n", ["1 rows"]),
        ("time_s,x_mm,y_mm\n0,0,0\n1,0,0\n", ["line 1", "no column for z"]),
        ("time_s,x_mm,y_mm,z_deg\n0,0,0,0\n", ["column 4", "`z_deg`", "z_mm"]),
        ("time_s,x_mm,y_mm,z\n0,0,0,0\n", ["column 4", "`z`", "z_mm"]),
        (f"{HEADER},u_mm\n0,0,0,0,0\n", ["column 5", "`u_mm`"]),
        (f"{HEADER},x_m\n0,0,0,0,0\n", ["column 5", "only one column of x"]),
        (f"{HEADER},i,j\n0,0,0,0,0,0\n", ["all of i, j, k"]),
        (f"{HEADER}\n0,0,0,0\n1,nan,0,0\n", ["line 3, column 2 (x_mm)", "`nan`"]),
        (f"{HEADER}\n0,0,0,0\n1,0,1e999,0\n", ["line 3, column 3", "1e999"]),
        (f"{HEADER}\n0,0,0,0\n1,0,a,\n", ["column 3", "`a`", "column 4", "``"]),
        (f"{HEADER}\n0,0,0,0\n1,0,0\n", ["line 3", "3 values", "4 columns"]),
        (f"{HEADER}\n0,0,0,0\n0,1,0,0\n", ["line 3", "must increase"]),
        (f"{HEADER}\n2,0,0,0\n1,1,0,0\n", ["line 3", "1 s after 2 s"]),
        (f"{HEADER},rapid\n0,0,0,0,2\n1,0,0,0,0\n", ["line 2", "0 and 1"]),
        (f"{HEADER},i,j,k\n0,0,0,0,0,0,0\n1,0,0,0,0,0,1\n", ["line 2", "unit vector"]),
    ],
)
def test_faults_are_named(read, text, parts):
    with pytest.raises(ProgramError) as caught:
        read(text)
    assert str(caught.value).startswith("path.csv")
    for part in parts:
        assert part in str(caught.value)


def test_all_faults_are_listed_up_to_twenty(read):
    rows = "".join(f"{k},x,0,0\n" for k in range(50))
    with pytest.raises(ProgramError) as caught:
        read(f"{HEADER}\n{rows}")
    assert len(caught.value.faults) == 20
    assert "further faults" in str(caught.value)


def test_missing_file_is_named(tmp_path):
    with pytest.raises(ProgramError, match=r"nothing\.csv"):
        read_path_csv(tmp_path / "nothing.csv")


def test_only_a_stated_axis_is_turned(tmp_path):
    rows = ["time_s,x_mm,y_mm,z_mm{}", "0,0,0,0{}", "1,9,0,0{}"]
    for more in (("", "", ""), (",i,j,k", ",0,0,-1", ",0,0,-1")):
        file = tmp_path / "path.csv"
        file.write_text("\n".join(map(str.format, rows, more)))
        path = read_path_csv(file, is_axis_to_tip=True)
        assert np.asarray(path.axes)[:, 2].tolist() == [1, 1]


T = "Time [ms]\tX [mm]\tY [mm]\tZ [mm]"


@pytest.mark.parametrize(
    ("text", "lean"),
    [
        # Tabs and decimal commas, below a header of its own.
        (f"Recorder 3\n\n{T}\n0,0\t1,5\t2\t3\n4,0\t1,5\t2\t4\n8,0\t1,5\t2\t5\n", 0),
        # A clock, units in a row of their own, A B C of a tool that leans by 30 deg.
        (
            "Time;X;Y;Z;A;B;C\ns;mm;mm;mm;deg;deg;deg\n"
            "23:59:59,996;1,5;2;3;0;30;180\n00:00:00,000;1,5;2;4;0;30;180\n"
            "00:00:00,004;1,5;2;5;0;30;180\n",
            30,
        ),
        # A quaternion of a tool that points down.
        (
            "t (s),TCP_X (mm),TCP_Y (mm),TCP_Z (mm),q1,q2,q3,q4\n"
            "7,1.5,2,3,0,1,0,0\n7.004,1.5,2,4,0,1,0,0\n7.008,1.5,2,5,0,1,0,0\n",
            0,
        ),
    ],
)
def test_tables_of_recorders(read, text, lean):
    path = read(text)
    np.testing.assert_allclose(path.time, [0, 0.004, 0.008], atol=1e-12)
    places = 1e-3 * np.array([[1.5, 2, 3], [1.5, 2, 4], [1.5, 2, 5]])
    np.testing.assert_allclose(path.positions, places, atol=1e-12)
    # B turns about y, so that the shank, which points up, leans to +x.
    axis = [np.sin(np.radians(lean)), 0, np.cos(np.radians(lean))]
    np.testing.assert_allclose(path.axes, [np.abs(axis)] * 3, atol=1e-12)


def test_a_row_that_is_written_twice_is_left_out(read):
    rows = [f"{4 * k}\t{k}\t0\t0" for k in range(300)]
    rows.insert(7, rows[6])
    path = read("\n".join([T, *rows]))
    np.testing.assert_allclose(path.time, 4e-3 * np.arange(300), atol=1e-12)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("Time [s];X;Y;Z\n0;1;2;3\n1;2;3;4\n2;3;4;5\n", "has no unit"),
        ("Time [s];X [mm];Y [mm]\n0;1;2\n1;2;3\n2;3;4\n", "x, y"),
        ("no table\nat all\n", "no table"),
        (f"{T}\tA [deg]\n" + "0\t1\t2\t3\t4\n4\t1\t2\t3\t4\n" * 2, "all of A, B, C"),
        (f"{T}\n" + "".join(f"{k}\t1\t2\t3\n" for k in (9, 8, 7, 6)), "must increase"),
        (f"{T}\n0\t1\t2\t3\n4\t1\t\t3\n8\t1\t2\t3\n", "line 3, column 3 .Y.: found ``"),
        (f"{T}\n0\t1\t2\t3\n4\t1\t2\n8\t1\t2\t3\n", "line 3: found 3 values"),
        (f"{T}\n0\t1\t2\t3\n4\t1\t2\t3\nThe end\n", "line 4: found 1 values"),
        (f"{T}\n0\t1\t2\t3\n0\t1\t2\t4\n4\t1\t2\t3\n", "line 3.*must increase"),
        (f"{T}\tX [in]\n" + "0\t1\t2\t3\t4\n4\t1\t2\t3\t4\n", "one column of x"),
        (
            f"{T}\tq1\tq2\tq3\tq4\n0\t1\t2\t3\t0\t1\t0\t0\n4\t1\t2\t3\t0\t0\t0\t0\n",
            "line 3: the quaternion has no length",
        ),
        (f"{T}\n0\t1e9\t2\t3\n4\t1\t2\t3\n8\t1\t2\t3\n", "from zero"),
    ],
)
def test_tables_that_leave_something_open_are_refused(read, text, part):
    with pytest.raises(ProgramError, match=part):
        read(text)


def test_further_columns_of_a_recorder_are_left_out(read):
    rows = "0\t1\t2\t3\tcut\t7\n4\t1\t2\t4\tcut\t\n"
    path = read(f"Log of 3 May\n{T}\tstate\tcurrent [A]\n{rows}")
    np.testing.assert_allclose(path.positions, 1e-3 * np.array([[1, 2, 3], [1, 2, 4]]))
    np.testing.assert_array_equal(path.line, [3, 4])


def test_names_in_a_comment_and_angles_of_a_tool(read):
    # As NumPy writes a header; B turns the shank, which points up, to +x.
    path = read(
        "# time_s x_mm y_mm z_mm a_deg b_deg c_deg\n0 1 2 3 0 90 180\n"
        + "1 1 2 4 0 0 180\n"
    )
    np.testing.assert_allclose(path.axes, [[1, 0, 0], [0, 0, 1]], atol=1e-12)
    np.testing.assert_array_equal(path.line, [2, 3])
