"""Measured records in the files of laboratory programs, written here."""

import importlib

import h5py
import numpy as np
import pytest
import scipy.io
import xarray

from diffmill import io

nptdms = pytest.importorskip("nptdms")
pytest.importorskip("pymatreader")

RATE = 10e3
TIME = np.arange(200) / RATE
FORCE = np.random.default_rng(0).normal(size=(200, 3))
NAMES = ("Fx", "Fy", "Fz")


def check(record):
    np.testing.assert_allclose(record.time, TIME, atol=1e-12)
    np.testing.assert_allclose(record.force, FORCE, rtol=1e-12)
    assert record.rate == pytest.approx(RATE)


def write_tdms(file, groups=("Cut",), scale=1.0, **properties):
    with nptdms.TdmsWriter(file) as writer:
        writer.write_segment(
            [
                nptdms.ChannelObject(group, name, scale * force, dict(properties))
                for group in groups
                for name, force in zip(NAMES, FORCE.T, strict=True)
            ]
        )


def test_tdms_channels_carry_unit_and_rate(tmp_path):
    file = tmp_path / "cut.tdms"
    write_tdms(file, scale=1e-3, unit_string="kN", wf_increment=1 / RATE)
    check(io.load_record(file))
    # What it begins with decides, not its name.
    check(io.load_record(file.rename(tmp_path / "cut.dat")))


def test_tdms_with_several_cuts_asks_which_one(tmp_path):
    file = tmp_path / "cut.tdms"
    write_tdms(file, groups=("First", "Second"), unit_string="N", wf_increment=1 / RATE)
    with pytest.raises(io.RecordError, match="1 `First/Fx`, 4 `Second/Fx`"):
        io.load_record(file)
    check(io.load_record(file, {name: f"Second/{name}" for name in NAMES}))


def test_tdms_with_a_time_channel(tmp_path):
    file = tmp_path / "cut.tdms"
    with nptdms.TdmsWriter(file) as writer:
        channels = [nptdms.ChannelObject("Cut", "Time [ms]", TIME * 1e3)]
        for name, force in zip(NAMES, FORCE.T, strict=True):
            channels.append(nptdms.ChannelObject("Cut", f"{name} [N]", force))
        writer.write_segment(channels)
    check(io.load_record(file))


VARIABLES = {"t": TIME, **dict(zip(NAMES, FORCE.T, strict=True))}


@pytest.mark.parametrize(
    "content",
    [
        VARIABLES,
        {"record": {**VARIABLES, "operator": "somebody"}, "note": "a text"},
        {**{name: VARIABLES[name][:, None] for name in NAMES}, "Fs": RATE},
        {
            "data": np.column_stack([TIME, FORCE]),
            "labels": np.array(["t_s", "Fx_N", "Fy_N", "Fz_N"], dtype=object),
        },
    ],
)
def test_mat_5(tmp_path, content):
    file = tmp_path / "cut.mat"
    scipy.io.savemat(file, content)
    check(io.load_record(file))


def test_a_rate_of_three_decimals_in_a_mat_file_is_no_text(tmp_path):
    file = tmp_path / "cut.mat"
    forces = {name: VARIABLES[name] for name in NAMES}
    scipy.io.savemat(file, {**forces, "Fs": 512.125})
    assert io.load_record(file).rate == 512.125


def test_a_bare_matrix_asks_for_its_columns(tmp_path):
    file = tmp_path / "cut.mat"
    scipy.io.savemat(file, {"data": np.column_stack([TIME, FORCE])})
    with pytest.raises(io.RecordError, match="1 `data:1`, 2 `data:2`"):
        io.load_record(file)
    check(io.load_record(file, {"time": 1, "Fx": 2, "Fy": 3, "Fz": "data:4"}))


def test_mat_73(tmp_path):
    file = tmp_path / "cut.mat"
    with h5py.File(file, "w", userblock_size=512) as content:
        for name, value in VARIABLES.items():
            dataset = content.create_dataset(name, data=value[None])
            dataset.attrs["MATLAB_class"] = np.bytes_("double")
    with file.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    check(io.load_record(file))


@pytest.mark.parametrize("engine", ["h5netcdf", "scipy"])
def test_netcdf(tmp_path, engine):
    file = tmp_path / "cut.nc"
    xarray.Dataset(
        {"force": (("time", "axis"), FORCE * 1e-3, {"units": "kN"})},
        {"time": ("time", TIME * 1e6, {"units": "us"}), "axis": ["x", "y", "z"]},
    ).to_netcdf(file, engine=engine)
    check(io.load_record(file))


def test_netcdf_of_vectors_and_a_date(tmp_path):
    file = tmp_path / "cut.nc"
    xarray.Dataset(
        {name: ("t", force, {"units": "N"}) for name, force in VARIABLES.items()}
    ).drop_vars("t").assign_coords(
        time=("t", TIME, {"units": "seconds since 2024-01-01"})
    ).to_netcdf(file, engine="h5netcdf")
    check(io.load_record(file))


def test_channels_of_different_length_are_refused(tmp_path):
    file = tmp_path / "cut.mat"
    scipy.io.savemat(file, {**VARIABLES, "Fz": FORCE[:100, 2]})
    with pytest.raises(io.RecordError, match="Fy 200, Fz 100"):
        io.load_record(file)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("cut.tdms", b"TDSm" + bytes(range(200))),
        ("cut.mat", b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + b"\xff" * 50),
        ("cut.nc", b"\x89HDF\r\n\x1a\n" + b"\xff" * 100),
        ("empty.mat", b""),
        ("empty.nc", b""),
        ("empty.tdms", b""),
    ],
)
def test_broken_files_are_record_errors(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(io.RecordError, match=name):
        io.load_record(tmp_path / name)


def test_an_absent_package_names_the_extra(tmp_path, monkeypatch):
    file = tmp_path / "cut.tdms"
    write_tdms(file, unit_string="N")

    def absent(name):
        raise ImportError(name)

    monkeypatch.setattr(importlib, "import_module", absent)
    with pytest.raises(io.RecordError, match=r"nptdms.* `forces`"):
        io.load_record(file)
