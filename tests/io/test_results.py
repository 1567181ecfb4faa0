import errno

import numpy as np
import pytest
import xarray
from helpers import names, python

from diffmill import workpiece
from diffmill.cli import main
from diffmill.io import described, mark_incomplete, write_results


@pytest.fixture
def dataset():
    rows = 7
    time = np.arange(rows) * 1e-3
    positions = np.outer(time, [0.05, 0.0, 0.0])
    return xarray.Dataset(
        {
            "time": ("step", time),
            "desired": (("step", "axis"), positions),
            "actual": (("step", "axis"), positions + 1e-5),
            "force": (("step", "axis"), np.ones((rows, 3))),
            "is_cutting": ("step", np.arange(rows) > 2),
        },
        coords={"axis": ["x", "y", "z"]},
        attrs={"job": "part", "source": "[cutter]\nteeth = 2\n"},
    )


def test_round_trip(tmp_path, dataset):
    out = write_results(tmp_path / "a" / "out", dataset, files={"x.txt": "text\n"})
    assert names(out) == ["manifest.txt", "result.nc", "x.txt"]
    with xarray.open_dataset(out / "result.nc") as read:
        for name in dataset.data_vars:
            np.testing.assert_array_equal(read[name], dataset[name])
        for name in ("time", "desired", "actual", "force"):
            # xarray takes "s" for a unit of time only if asked to decode it.
            assert read[name].attrs["units"] in ("s", "m", "N")
        assert read.attrs["source"] == dataset.attrs["source"]
        assert read.attrs["Conventions"].startswith("CF-")
        assert f"numpy {np.__version__}" in read.attrs["versions"]
        assert read.attrs["incomplete"] == 0


def test_a_result_is_written_as_by_xarray(tmp_path, dataset):
    out = write_results(tmp_path / "out", dataset)
    wanted = described(dataset).to_netcdf(engine="h5netcdf")
    assert (out / "result.nc").read_bytes() == bytes(wanted)


def test_writing_starts_no_scheduler(tmp_path):
    code = (
        "import sys, xarray\n"
        "from diffmill.io import write_results\n"
        f"write_results({str(tmp_path / 'out')!r}, xarray.Dataset())\n"
        "print('distributed' in sys.modules)\n"
    )
    assert python(code).stdout == "False\n"


def test_any_attribute_can_be_written(tmp_path, dataset):
    dataset.attrs.update(
        flag=True, nothing=None, grid=(1.0, 2.0), table={"a": 1}, names=["x", "y"]
    )
    out = write_results(tmp_path / "out", dataset)
    with xarray.open_dataset(out / "result.nc") as read:
        assert read.attrs["flag"] == 1
        assert "nothing" not in read.attrs
        np.testing.assert_array_equal(read.attrs["grid"], [1.0, 2.0])
        assert read.attrs["table"] == "{'a': 1}"
        assert read.attrs["names"] == "['x', 'y']"


def test_variable_without_known_units_is_refused(tmp_path, dataset):
    dataset["mystery"] = ("step", np.zeros(7))
    with pytest.raises(ValueError, match="mystery"):
        write_results(tmp_path / "out", dataset)
    assert list(tmp_path.iterdir()) == []


def test_failure_leaves_nothing(tmp_path, dataset):
    def fail(path):
        path.write_text("half")
        raise RuntimeError("disk")

    with pytest.raises(RuntimeError, match="disk"):
        write_results(tmp_path / "out", dataset, files={"a.txt": fail})
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_said_with_the_folder(tmp_path, dataset):
    def fail(path):
        raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(OSError, match="No space left") as caught:
        write_results(tmp_path / "out", dataset, files={"a.txt": fail})
    assert caught.value.filename == str(tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_failure_keeps_earlier_results(tmp_path, dataset):
    out = write_results(tmp_path / "out", dataset, files={"a.txt": "first"})

    def fail(path):
        raise RuntimeError("disk")

    with pytest.raises(RuntimeError):
        write_results(out, dataset, fill=fail, force=True)
    assert (out / "a.txt").read_text() == "first"
    assert names(tmp_path) == ["out"]


def test_force_replaces_results_and_nothing_else(tmp_path, dataset):
    out = tmp_path / "out"
    out.mkdir()
    write_results(out, dataset, files={"old.txt": "old", "both.txt": "old"})
    (out / "mine.txt").write_text("mine")
    with pytest.raises(ValueError, match="--force"):
        write_results(out, dataset)
    write_results(out, dataset, files={"both.txt": "new"}, force=True)
    assert names(out) == ["both.txt", "manifest.txt", "mine.txt", "result.nc"]
    assert (out / "both.txt").read_text() == "new"


def test_manifest_cannot_reach_outside(tmp_path, dataset):
    out = write_results(tmp_path / "out", dataset)
    (tmp_path / "victim.txt").write_text("keep")
    (out / "manifest.txt").write_text("../victim.txt\n..\n.\n\n/tmp\nresult.nc\n")
    write_results(out, dataset, force=True)
    assert (tmp_path / "victim.txt").read_text() == "keep"


def test_names_stay_in_the_folder(tmp_path, dataset):
    with pytest.raises(ValueError):
        write_results(tmp_path / "out", dataset, files={"../x": "text"})
    assert list(tmp_path.iterdir()) == []


def test_folder_that_is_a_file(tmp_path, dataset):
    (tmp_path / "out").write_text("")
    with pytest.raises(ValueError, match="--out"):
        write_results(tmp_path / "out", dataset, force=True)
    with pytest.raises(ValueError, match="--out"):
        write_results(tmp_path / "out" / "below", dataset)


def test_a_check_before_the_run_writes_nothing(tmp_path):
    missing = str(tmp_path / "none.toml")
    assert main(["simulate", missing, "--out", str(tmp_path / "a" / "b")]) == 2
    assert list(tmp_path.iterdir()) == []


def test_stock_without_pickle(tmp_path, dataset):
    stock = workpiece.box([0.0, 0.0, 0.0], [2e-3, 3e-3, 1e-3], 0.5e-3)
    out = write_results(tmp_path / "out", dataset, stock=stock)
    with np.load(out / "stock.npz", allow_pickle=False) as read:
        assert read["spacing"] == 0.5e-3
        length = np.maximum(read["ends_z"][:, :, 1] - read["ends_z"][:, :, 0], 0)
        volume = length.sum() * read["spacing"] ** 2
        assert read["poses_z"].shape == read["ends_z"].shape
    assert volume == pytest.approx(6e-9)


def test_incomplete_run_is_cut_off_and_marked(tmp_path, dataset):
    dataset["actual"][4:] = np.nan
    marked = mark_incomplete(dataset, "it broke")
    out = write_results(tmp_path / "out", marked)
    with xarray.open_dataset(out / "result.nc") as read:
        assert read.sizes["step"] == 4
        assert np.isfinite(read["actual"]).all()
        assert read.attrs["incomplete"] == 1
        assert read.attrs["incomplete_reason"] == "it broke"
        assert read.attrs["incomplete_time"] == pytest.approx(4e-3)
        np.testing.assert_allclose(read.attrs["incomplete_place"], [2e-4, 0, 0])


def test_incomplete_run_stops_where_its_flag_rose(dataset):
    marked = mark_incomplete(dataset, "overflow", failed_step=2)
    assert marked.sizes["step"] == 2
    assert marked.attrs["incomplete_time"] == pytest.approx(2e-3)
    assert mark_incomplete(dataset, "at once", failed_step=0).sizes["step"] == 1
    assert "incomplete" not in dataset.attrs
