"""The figures by part of the path, in the report and the table of the command line."""

import numpy as np
import pytest

from diffmill.viz import case_parts, summary, write_report

from .synthetic import SCALES

KEYS = ("mean", "rms", "p95")
SIZE = np.array(list(SCALES.values()))


@pytest.fixture
def result(correction):
    rms = SIZE[:, None] * np.array([[80e-6, 60e-6, np.nan, 40e-6]])
    mean = SIZE[:, None] * np.array([[1e-6, -2e-6, 3e-6]])
    dataset = correction.assign(
        contour_mean=(("case", "axis"), mean),
        part_rms=(("case", "part"), rms),
        part_max=(("case", "part"), 2 * rms),
        part_rows=(("part",), np.array([10, 12, 0, 90], np.int32)),
        max_acceleration=(("case",), 1.0 + SIZE),
    ).assign_coords(part=["entry", "exit", "corner", "plateau"])
    dataset.attrs["mirror_forward_runs"] = 2
    return dataset


def test_figures_are_those_of_the_case(result):
    mirror = case_parts(result)[1]
    assert mirror.name == "mirror"
    assert mirror.rms["plateau"] == pytest.approx(0.45 * 40e-6)
    assert mirror.maximum["entry"] == pytest.approx(0.9 * 80e-6)
    assert mirror.rows == {"entry": 10, "exit": 12, "corner": 0, "plateau": 90}
    np.testing.assert_allclose(mirror.mean, 0.45e-6 * np.array([1.0, -2.0, 3.0]))
    assert (mirror.forward_runs, mirror.seconds) == (2, 0.9)
    assert mirror.max_acceleration == pytest.approx(1.45)


def test_report_and_command_line_leave_out_a_part_without_rows(tmp_path, result):
    page = write_report(tmp_path, result, {}).read_text(encoding="utf-8")
    assert "By part of the path" in page
    assert "80.0 / 160" in page and "corner: rms" not in page
    text = summary(result)
    assert "corner" not in text
    *_, mirror = [x for x in text.splitlines() if x.startswith("mirror ")]
    assert mirror.split()[1:] == [
        *("0.45", "-0.90", "1.35", "36.00", "27.00", "18.00"),
        *("1.45", "2", "0.9", "s"),
    ]


def test_leaving_the_cut_is_told(tmp_path, result):
    assert "warning" not in summary(result)
    left = np.zeros(len(SIZE), np.int32)
    left[1] = 7
    told = result.assign(rows_out_of_cut=(("case",), left))
    (line,) = [line for line in summary(told).splitlines() if "warning" in line]
    assert "mirror: the tool leaves the cut in 7 steps" in line
    page = write_report(tmp_path, told, {}).read_text(encoding="utf-8")
    assert "steps out of the cut" in page and 'out of the cut">7</td>' in page


def test_the_first_place_out_of_the_cut_is_told(tmp_path, result):
    is_out = np.zeros((len(SIZE), result.sizes["step"]), bool)
    is_out[1, [40, 41, 60]] = True
    told = result.assign(
        rows_out_of_cut=(("case",), is_out.sum(axis=1)),
        is_out_of_cut=(("case", "step"), is_out),
    )
    error = np.abs(result["contour_error"].sel(case="mirror").values)[is_out[1]].max()
    x, y, z = 1e3 * result["desired"].values[40]
    place = f"first at {result['time'].values[40]:.3f} s, x, y, z = "
    place += f"{x:.1f}, {y:.1f}, {z:.1f} mm"
    (line,) = [line for line in summary(told).splitlines() if "warning" in line]
    assert "in 3 steps" in line and place in line
    assert f"up to {1e6 * error:.3g} um" in line and "keeps a mark" in line
    assert place in write_report(tmp_path, told, {}).read_text(encoding="utf-8")


def test_a_simulation_has_no_such_table(tmp_path, simulation):
    assert case_parts(simulation) == ()
    lines = summary(simulation).splitlines()
    assert len(lines) == 3 and lines[2].split()[0] == "predicted"
    page = write_report(tmp_path, simulation, {}).read_text(encoding="utf-8")
    assert "By part of the path" not in page


def test_surface_figures_are_listed_by_kind(tmp_path, result):
    keys = [f"{kind}_{key}" for kind in ("wall", "floor") for key in KEYS]
    surface = {f"surface_{key}": (("case",), SIZE * 50e-6) for key in keys}
    surface["surface_floor_p95"] = (("case",), np.nan * SIZE)
    with_surface = result.assign(surface_deepest=(("case",), SIZE * 70e-6), **surface)
    page = write_report(tmp_path, with_surface, {}).read_text(encoding="utf-8")
    assert "Machined surface" in page
    cells = [cell.partition("<")[0] for cell in page.split(">")]
    at = cells.index("31.5")
    assert [cell for cell in cells[:at] if cell.strip()][-2:] == ["22.5", "-"]


def test_the_command_line_tells_walls_and_floors_apart(result):
    assert "machined surface" not in summary(result)
    sizes = {"wall_mean": 1, "wall_rms": 2, "wall_p95": 3, "deepest": 8}
    sizes |= {"floor_mean": -4, "floor_rms": 5, "floor_p95": np.nan}
    told = result.assign(
        {f"surface_{key}": ("case", 1e-6 * x * SIZE) for key, x in sizes.items()}
    )
    lines = summary(told).splitlines()
    (start,) = [k for k, x in enumerate(lines) if x.startswith("machined surface")]
    assert lines[start + 2].split() == [
        *("uncorrected", "1.00", "2.00", "3.00", "-4.00", "5.00", "-", "8.00")
    ]
