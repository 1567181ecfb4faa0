"""A corrected program is read back from its file and run."""

import pytest
import xarray
from helpers import cut_rms
from slides_job import write_slides_job

import diffmill as dm
from diffmill import io
from diffmill.cli import main
from diffmill.toolpath import Program, reduce_path, sample_program

OUTPUT = """
[output]
formats = ["gcode", "krl", "apt"]
tolerance = "15 um"
stream_cycle = "1 ms"
"""


@pytest.mark.slow
def test_the_error_of_the_written_program_is_stated(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    file = write_slides_job(tmp_path, 'method = "inverse_drive"')
    file.write_text(file.read_text() + OUTPUT)
    assert main(["correct", "job.toml", "--out", "out"]) == 0
    said = capsys.readouterr().err
    with xarray.open_dataset(tmp_path / "out" / "result.nc", engine="h5netcdf") as kept:
        found, case = kept.attrs, kept.sel(case="inverse_drive").load()
    own = cut_rms(case)

    # The blocks are known without their text, and the motion at every tooth instant.
    job = dm.load_job(file)
    path = io.read_path_csv(tmp_path / "out" / "corrected.csv")
    blocks = Program.of_path(reduce_path(path, 15e-6))
    read = sample_program(
        blocks,
        float(job.tooth_period),
        acceleration=1.0,
        rapid_feed=1.0,
        corner_tolerance=0.0,
    )
    run = dm.simulate(
        job,
        commanded=read.positions[: job.path.step_count],
        adjoint=dm.process.ThroughPoses(),
    )
    expected = cut_rms(run)
    assert expected > 1.2 * own
    # Text holds a nanometre.
    assert found["written_rms_ngc"] == pytest.approx(expected, abs=10e-9)
    assert found["written_rms_src"] == pytest.approx(expected, abs=10e-9)
    # A cycle is much shorter than a tooth period.
    assert found["stream_rms_csv"] == pytest.approx(own, rel=0.1)
    assert "written_rms_apt" not in found and "corrected.apt: not run" in said
    assert f"{expected * 1e6:.2f} um" in said and "[output] tolerance" in said


@pytest.mark.slow
def test_the_program_with_its_own_blocks_is_read_back_and_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = write_slides_job(tmp_path, 'method = "inverse_drive"')
    file.write_text(file.read_text() + "\n[output]\nmoved_ends = true\n")
    assert main(["correct", "job.toml", "--out", "out", "--quiet"]) == 0
    with xarray.open_dataset(tmp_path / "out" / "result.nc", engine="h5netcdf") as kept:
        left = kept.attrs["moved_rms_ngc"]
        cases = kept.load()
    inverted, before = (
        cut_rms(cases.sel(case=name)) for name in ("inverse_drive", "uncorrected")
    )
    assert inverted < left < before
    read = lambda name: io.parse_gcode((tmp_path / name).read_text())
    moved, program = read("out/moved.ngc"), read("part.ngc")
    feeds = [move.feed for move in moved.moves]
    assert feeds[-3:] == [move.feed for move in program.moves[-3:]]


@pytest.mark.slow
def test_a_corrected_robot_program_has_the_orientation_of_its_source(
    tmp_path, monkeypatch
):
    """The usual tool of KUKA: the cutter along its x, upright at A 0, B 90, C 0."""
    monkeypatch.chdir(tmp_path)
    file = write_slides_job(tmp_path, 'method = "inverse_drive"')
    place = "{{X {},Y {},Z {},A 0,B 90,C 0}}"
    text = "DEF part( )\n$VEL.CP=0.05\n"
    text += f"PTP {place.format(-5.5, 1, 1)}\nPTP {place.format(-5.5, 1, -0.8)}\n"
    text += f"LIN {place.format(6, 1, -0.8)}\nLIN {place.format(6, 4, -0.8)}\nEND"
    (tmp_path / "part.src").write_text(text)
    job = file.read_text().replace('"part.ngc"', '"part.src"\ntool_axis = "x"')
    file.write_text(job + '\n[output]\nformats = ["krl"]\nmoved_ends = true\n')
    assert main(["correct", "job.toml", "--out", "out", "--quiet"]) == 0
    for name in ("corrected.src", "moved.src"):
        rows = (tmp_path / "out" / name).read_text().splitlines()
        (comment,) = (row for row in rows if "motion only" in row)
        assert "its tip, x of it pointing from the shank to the tip" in comment
        positions = [row for row in rows if "{X" in row]
        assert positions[0].startswith("PTP {X -5.5")
        assert all("A 0,B 90,C 0}" in row for row in positions)
    with xarray.open_dataset(tmp_path / "out" / "result.nc", engine="h5netcdf") as kept:
        found = kept.attrs
    # Nothing is known of the times of its lines: the report says so.
    assert "SLIN" in (tmp_path / "out" / "corrected.src").read_text()
    assert "stops where straight" in found["written_untimed_src"]
    box = (tmp_path / "out" / "report.html").read_text().split("Before you load it")[2]
    assert "times of corrected.src" in box
    # A tool that were read back lying flat would cut elsewhere.
    rms = found["written_rms_src"], found["moved_rms_src"]
    assert 0 < rms[0] < rms[1] < 1e-4
