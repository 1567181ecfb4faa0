"""`diffmill stability`: what it prints, writes and refuses."""

import math

import numpy as np
import pytest
import xarray
from slides_job import JOB, with_machine, write_slides_job

from diffmill import sim
from diffmill.cli import main
from diffmill.viz import plot_lobes

RPM = math.pi / 30


@pytest.mark.slow
def test_lobes_of_a_job_are_written(here, capsys):
    write_slides_job(here)
    command = ["stability", "job.toml", "--speeds", "4000", "9000"]
    assert main(command) == 0
    said, out = capsys.readouterr().out, here / "job-stability"
    for part in ("and the limit there", "speeds to prefer", "process damping"):
        assert part in said
    assert (out / "summary.txt").read_text() in said
    assert (out / "lobes.png").stat().st_size > 1000
    with xarray.open_dataset(out / "result.nc", engine="h5netcdf") as found:
        np.testing.assert_allclose(found["speed"][[0, -1]], RPM * np.r_[4000, 9000])
        assert found["limit"].dims == ("place", "speed")
        assert found["limit"].attrs["units"] == "m"
        # The program cuts 0.8 mm deep.
        np.testing.assert_allclose(found["depth"].max(), 0.8e-3, rtol=0.05)


def test_a_chattering_program_is_told(here, monkeypatch, capsys):
    write_slides_job(here)
    speed = RPM * np.array([6000.0, 8000.0])
    lobes = sim.StabilityLobes(
        row=np.array([9]),
        position=np.array([[1e-3, 2e-3, -1e-3]]),
        depth=np.array([2e-3]),
        speed=speed,
        limit=np.array([[np.inf, 1e-3]]),
        frequency=np.array([[np.nan, 51.25]]),
        own_speed=float(speed[1]),
        deepest=8e-3,
    )

    def found(*_, on_progress, **__):
        on_progress("depth limits", 0.0)
        return lobes

    monkeypatch.setattr(sim, "stability_lobes", found)
    assert main(["stability", "job.toml"]) == 0
    said, told = capsys.readouterr()
    for stage in ("rigid cut: ", "the deepest places", "depth limits"):
        assert stage in told
    for part in ("CHATTER", "51.2 Hz", "no limit found", "up to 8 mm"):
        assert part in said


@pytest.mark.parametrize(
    ("limit", "label", "drawn"),
    [
        ([np.inf, 1e-3], "limit at (1.0, 2.0, -1.0) mm", [np.nan, 1.0]),
        ([np.inf, np.inf], "no limit up to 8 mm at (1.0, 2.0, -1.0) mm", 2 * [np.nan]),
    ],
)
def test_a_limit_that_was_not_found_has_no_line(limit, label, drawn):
    lobes = xarray.Dataset(
        {
            "limit": (("place", "speed"), [limit]),
            "depth": ("place", [2e-3]),
            "position": (("place", "axis"), [[1e-3, 2e-3, -1e-3]]),
        },
        coords={"speed": RPM * np.array([6000.0, 8000.0])},
        attrs={"own_speed_rad_s": RPM * 8000, "deepest_m": 8e-3},
    )
    line = plot_lobes(lobes).axes[0].lines[0]
    assert line.get_label() == label
    np.testing.assert_allclose(np.asarray(line.get_ydata()), drawn)


def test_what_has_no_lobes_is_refused(here, capsys):
    file = write_slides_job(here)
    for speeds in (["9000", "4000"], ["0", "4000"]):
        assert main(["stability", "job.toml", "--speeds", *speeds]) == 2
        assert "--speeds: found" in capsys.readouterr().err
    file.write_text(with_machine(JOB, "[robot]\nrigid = true\n"))
    assert main(["stability", "job.toml"]) == 2
    assert "does not vibrate" in capsys.readouterr().err
    assert not (here / "job-stability").exists()
