import errno
import importlib.util
import json
import os
import pathlib
import re
import subprocess
import sys

import jax
import numpy as np
import pytest
import xarray
from helpers import cut_rms, names, python

import diffmill as dm
from diffmill import examples, load_job
from diffmill.cli import main
from small_job import CUTS, small_job

NAME = "OPENBLAS_NUM_THREADS"
ROOT = pathlib.Path(__file__).parents[1]
JOB = small_job('diameter = "10 mm"\nteeth = 2')


@pytest.fixture
def folder(here):
    (here / "job.toml").write_text(JOB)
    (here / "part.ngc").write_text(CUTS)
    return here


@pytest.mark.parametrize(("given", "taken"), [({}, "1"), ({NAME: "3"}, "3")])
def test_lapack_takes_one_thread_before_it_is_loaded_unless_told(given, taken):
    code = (
        "import os, runpy, sys, types\n"
        "module = types.ModuleType('diffmill.cli')\n"
        "sys.modules['diffmill.cli'] = module\n"
        f"module.main = lambda: print(os.environ['{NAME}'], 'numpy' in sys.modules)\n"
        "runpy.run_module('diffmill', run_name='__main__')\n"
    )
    plain = {name: x for name, x in os.environ.items() if name != NAME}
    assert python(code, env=plain | given).stdout == f"{taken} False\n"


def test_help_and_usage(capsys):
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    for command in ("simulate", "correct", "feed", "robot", "example", "check"):
        assert command in text
    assert main(["simulate", "--help"]) == 0
    text = capsys.readouterr().out
    for option in ("--out", "--force", "--quiet", "--allow-outside"):
        assert option in text
    assert main(["--version"]) == 0
    assert re.fullmatch(r"diffmill \d+\.\d+.*\n", capsys.readouterr().out)


@pytest.mark.parametrize(
    ("line", "found", "allowed"),
    [
        ("", "no command", ("simulate", "identify", "--version")),
        ("simulat job.toml", "'simulat'", ("simulate", "correct", "check")),
        ("--verbose", "--verbose", ("simulate", "--help")),
        ("simulate", "JOB.toml", ("required",)),
        ("simulate a.toml b.toml", "'b.toml'", ("JOB.toml",)),
        ("simulate job.toml --fource", "--fource", ("--force", "--out")),
        ("simulate job.toml --out", "--out", ("no value", "required")),
        ("simulate job.toml --out --force", "--out", ("no value", "required")),
        ("feed job.toml --overrides 1 x", "'x'", ("--overrides", "numbers")),
        ("robot --pose", "--pose", ("no value",)),
    ],
)
def test_a_wrong_command_line_is_one_line(capsys, line, found, allowed):
    assert main(line.split()) == 2
    (error,) = capsys.readouterr().err.splitlines()
    assert error.startswith("error: ") and found in error
    assert all(word in error for word in allowed)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("teeth = 2", "teeth = two", ("line 3", "'teeth = two'", '"10 mm"')),
        ("teeth = 2", "teeth = 2\nteeth = 3", ("line 4", "'teeth = 3'", "once")),
        ("[spindle]", "[cutter]", ("line 4", "'[cutter]'", "once")),
        ('"8000 rpm"', "8000 rpm", ("line 5", "8000 rpm", '"10 mm"')),
        ('"8000 rpm"', '"8000 rpm', ("line 5", "quote")),
    ],
)
def test_invalid_toml_shows_its_line(folder, capsys, old, new, words):
    (folder / "job.toml").write_text(JOB.replace(old, new))
    assert main(["check", "job.toml"]) == 2
    _, error = capsys.readouterr().err.splitlines()
    assert all(word in error for word in words)


@pytest.mark.slow
def test_verbose_names_what_is_compiled(folder, capsys):
    # Of a size that no other test has compiled.
    (folder / "job.toml").write_text(JOB.replace('"8 mm", "8 mm"', '"7 mm", "4.5 mm"'))
    assert main(["simulate", "job.toml", "--out", "out", "--verbose"]) == 0
    text = capsys.readouterr().err
    assert re.search(r"diffmill \S+ jax \S+ on .*cpu", text, re.IGNORECASE)
    assert "compiled, or read from the cache: " in text
    assert main(["simulate", "job.toml", "--quiet", "--verbose"]) == 2
    assert "--quiet and --verbose" in capsys.readouterr().err


def test_what_is_refused_at_once_imports_no_jax(folder):
    (folder / "bad.toml").write_text("[cutter")
    typo = JOB.replace("diameter", "diametr") + "[correction]\nknots = 3\n"
    (folder / "typo.toml").write_text(typo)
    lines = ["--help", "--version", "correct --help", "wrong", "simulate none.toml"]
    lines += [f"{name} bad.toml" for name in ("simulate", "feed", "identify", "check")]
    jobs = ("simulate", "correct", "feed", "check")
    lines += [f"{name} typo.toml" for name in jobs]
    lines += [
        f"{name} job.toml --out ."
        for name in ("simulate", "correct", "feed", "identify", "robot")
    ]
    code = "import sys; from diffmill.cli import main\n" + "".join(
        f"main({line.split()!r})\nassert 'jax' not in sys.modules, {line!r}\n"
        for line in lines
    )
    python(code, cwd=folder, check=True)


def test_examples_are_listed_and_each_is_one_that_can_be_written(folder, capsys):
    assert main(["example"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) >= 4
    for name in (line.split()[0] for line in lines):
        assert main(["example", name]) == 0
        assert (folder / f"{name}.toml").exists()


@pytest.mark.slow
def test_the_first_example_is_corrected_without_a_robot(folder, capsys):
    assert main(["example", "tiny", "--quiet"]) == 0
    assert main(["correct", "tiny.toml", "--out", "out", "--quiet", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    with xarray.open_dataset(folder / "out" / "result.nc", engine="h5netcdf") as found:
        rms = {case: cut_rms(found.sel(case=case)) for case in found["case"].values}
        assert "joint_positions" not in found
        for case, numbers in printed["cases"].items():
            assert numbers["rms"] == pytest.approx(rms[case])
        assert rms["corrected"] < 0.1 * rms["uncorrected"]


@pytest.mark.slow
def test_the_surface_that_is_written_is_that_of_the_corrected_program(folder):
    assert main(["example", "tiny", "--quiet"]) == 0
    text = (folder / "tiny.toml").read_text()
    (folder / "tiny.toml").write_text(f'{text}method = "mirror"\n')
    assert main(["correct", "tiny.toml", "--out", "out", "--quiet"]) == 0
    with xarray.open_dataset(folder / "out" / "surface.nc") as surface:
        assert set(surface["case"].values) == {"uncorrected", "mirror"}


@pytest.mark.slow
def test_a_shank_in_the_stock_is_told_and_is_no_success(folder, capsys):
    assert main(["example", "tiny", "--quiet"]) == 0
    text = (folder / "tiny.toml").read_text()
    short = text.replace("teeth = 2", 'teeth = 2\nflute_length = "0.4 mm"')
    (folder / "tiny.toml").write_text(short)
    assert main(["correct", "tiny.toml", "--out", "out"]) == 0
    printed = capsys.readouterr().out
    assert "Not within" in printed and "shank" in printed
    with xarray.open_dataset(folder / "out" / "result.nc", engine="h5netcdf") as found:
        assert found.shank_volume.dims == ("case", "step")
        assert (found.shank_volume.sum("step") > 1e-9).all()


@pytest.mark.parametrize("name", ["tiny", "paper", "paper_small"])
def test_example(folder, capsys, name):
    assert main(["example", name]) == 0
    assert f"diffmill correct {name}.toml" in capsys.readouterr().out
    assert (folder / f"{name}.ngc").exists()
    (folder / f"{name}.toml").write_text("mine")
    assert main(["example", name]) == 2
    assert "--force" in capsys.readouterr().err
    assert (folder / f"{name}.toml").read_text() == "mine"
    assert main(["example", name, "--force"]) == 0
    assert "[cutter]" in (folder / f"{name}.toml").read_text()


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_shell_is_told_what_completes(capsys, shell):
    assert main(["--completion", shell]) == 0
    script = capsys.readouterr().out
    assert "tolerance-band" in script and "doctor" in script
    assert main(["--completion", "none"]) == 2
    assert shell in capsys.readouterr().err


def test_unknown_example(folder, capsys):
    before = names(folder)
    assert main(["example", "nothing"]) == 2
    assert "paper_small" in capsys.readouterr().err
    assert names(folder) == before


def test_example_programs_come_from_their_generator(tmp_path):
    script = ROOT / "experiments" / "paper_part" / "generate.py"
    spec = importlib.util.spec_from_file_location("paper_part", script)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["paper_part"] = module
    spec.loader.exec_module(module)
    for part in (module.PAPER, module.PAPER_SMALL):
        file = examples.copy_example(part.name, tmp_path).with_suffix(".ngc")
        assert file.read_text(encoding="utf-8") == module.program(part)


@pytest.mark.parametrize(
    ("name", "fewest", "most"), [("paper", 2500, 3500), ("paper_small", 1500, 2500)]
)
def test_examples_load(tmp_path, name, fewest, most):
    job = load_job(examples.copy_example(name, tmp_path))
    assert fewest <= job.path.step_count <= most
    assert job.robot is not None
    damping, chatter = job.notes
    assert "joint_damping: 2.5 times that of the robot's own file, reis_rv" in damping
    assert "the end of the cutter chatters" in chatter
    assert job.tooth_period == pytest.approx(3.75e-3)


def test_bad_job(folder, capsys):
    (folder / "job.toml").write_text(JOB.replace("teeth = 2", "teeth = 0"))
    before = names(folder)
    for command in ("simulate", "correct", "check"):
        assert main([command, "job.toml"]) == 2
        error = capsys.readouterr().err
        assert "job.toml: 1 problem" in error
        assert "[cutter] teeth: found 0, but at least 1 is required" in error
    assert main(["simulate", "none.toml"]) == 2
    assert names(folder) == before


def test_correct_needs_a_robot(folder, capsys):
    assert main(["correct", "job.toml"]) == 2
    assert "[robot] rigid" in capsys.readouterr().err


def test_folder_is_refused_before_anything_runs(folder, capsys):
    (folder / "out").mkdir()
    (folder / "out" / "mine.txt").write_text("mine")
    assert main(["simulate", "job.toml", "--out", "out"]) == 2
    error = capsys.readouterr().err
    assert "--force" in error
    assert "not empty" in error
    assert names(folder / "out") == ["mine.txt"]


@pytest.mark.parametrize("text", ["20", "20 kg", "0 um", "wide"])
def test_a_tolerance_on_the_command_line_is_a_length(folder, capsys, text):
    before = names(folder)
    assert main(["simulate", "job.toml", "--tolerance-band", text]) == 2
    (error,) = capsys.readouterr().err.splitlines()
    assert "--tolerance-band" in error and repr(text) in error and "length" in error
    assert names(folder) == before


@pytest.mark.slow
def test_simulate_rigid(folder, capsys):
    assert main([*"simulate job.toml --quiet --tolerance-band".split(), "20 um"]) == 0
    captured = capsys.readouterr()
    assert captured.out + captured.err == ""
    assert "Within 20 " in (folder / "job-simulate" / "report.html").read_text("utf-8")
    out = folder / "job-simulate"
    assert {"result.nc", "stock.npz", "surface.nc", "report.html"} <= set(names(out))
    with xarray.open_dataset(out / "result.nc") as result:
        assert result.attrs["source"] == JOB
        np.testing.assert_array_equal(result["actual"], result["desired"])
        assert float(np.abs(result["force"]).max()) > 1.0
        for name in result.data_vars:
            assert result[name].attrs["units"]
    with xarray.open_dataset(out / "surface.nc") as surface:
        assert {"surface_error", "position", "normal"} <= set(surface.data_vars)
        is_cut, is_floor = (surface[k].values > 0 for k in ("is_cut", "is_floor"))
        assert (is_cut & is_floor).any() and (is_cut & ~is_floor).any()
        assert float(np.abs(surface["surface_error"]).max()) < 1e-12
        assert set(surface["case"].values) == {"predicted"}


@pytest.mark.slow
def test_aborted_run_is_kept(folder, capsys):
    # One slot per ray cannot hold what a slot through the middle leaves.
    job = JOB.replace("[program]", "intervals = [1, 1, 1]\n[program]")
    job = job.replace('"10 mm"', '"3 mm"')
    (folder / "job.toml").write_text(job)
    program = CUTS.replace("X-2 F3000", "X12 F3000").replace("G0 X-6\n", "")
    (folder / "part.ngc").write_text(program)
    assert main(["simulate", "job.toml", "--out", "out"]) == 1
    error = capsys.readouterr().err
    assert "intervals" in error
    assert " s, commanded tip" in error
    with xarray.open_dataset(folder / "out" / "result.nc") as result:
        assert result.attrs["incomplete"] == 1
        assert "intervals" in result.attrs["incomplete_reason"]
        assert result.sizes["step"] >= 1


def test_convert_there_and_back(folder, capsys):
    (folder / "two.ngc").write_text("T1 M6\nG0 X0 Y0 Z1\nG1 X5 F60\nG2 X9 R4\nM2\n")
    assert main(["convert", "two.ngc", "two.src"]) == 0
    assert main(["convert", "two.src", "two.csv"]) == 0
    assert main(["convert", "two.csv", "two.mod", "--tolerance", "5 um"]) == 0
    for name in ("two.src", "two.csv", "two.mod"):
        assert main(["check", name]) == 0
        assert "z: 1.000 to 1.000 mm" in capsys.readouterr().out
    assert main(["convert", "two.ngc", "two.src"]) == 2
    assert main(["convert", "two.ngc", "two.foo"]) == 2
    assert main(["convert", "two.ngc", "two.mod", "--force", "--tolerance", "5"]) == 2
    assert not list(folder.glob(".two*"))


RETRACT = (
    "G21 G90 F60\nG0 X0 Y0 Z5\nG43 H1 Z5\nG1 Z-1\nG53 G0 Z0\nG41 D2 G1 X9 Z5\nM2\n"
)


def test_check_and_convert_take_what_a_program_leaves_to_the_control(folder, capsys):
    (folder / "retract.ngc").write_text(RETRACT)
    keys = ['tool_radii = { 2 = "3 mm" }', 'machine_zero = ["0 mm", "0 mm", "300 mm"]']
    keys.append('tool_lengths = { 1 = "80 mm" }')
    assert main(["check", "retract.ngc", "--program", *keys]) == 0
    # 300 mm for the zero, 80 mm for the tool.
    assert "z: -1.000 to 220.000 mm" in capsys.readouterr().out
    assert main(["convert", "retract.ngc", "out.apt", "--program", *keys]) == 0
    assert "GOTO/" in (folder / "out.apt").read_text()
    for key, part in (
        ('tool_radii = { 2 = "3" }', "without a unit"),
        ('corner_tolerance = "1 mm"', "found 'corner_tolerance'; allowed: feed"),
        ("tool_radii", "needed are keys as in a job"),
    ):
        assert main(["check", "retract.ngc", "--program", key]) == 2
        assert part in capsys.readouterr().err
    assert main(["check", "job.toml", "--program", "feed = '1 mm/s'"]) == 2
    assert "--program are for programs" in capsys.readouterr().err


def test_check_passes_over_the_calls_that_are_named(folder, capsys):
    moves = "LIN {X 0,Y 0,Z 5,A 0,B 0,C 180}\nLIN {X 9,Y 0,Z 5,A 0,B 0,C 180}\n"
    text = f"DEF part()\n$VEL.CP=0.1\nSPINDLE_ON(8000)\n{moves}END\n"
    (folder / "part.src").write_text(text)
    assert main(["check", "part.src"]) == 2
    assert "SPINDLE_ON" in capsys.readouterr().err
    named = ["--program", 'pass_over = ["SPINDLE_ON"]']
    assert main(["check", "part.src", *named]) == 0
    assert "SPINDLE_ON" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("target", "words"),
    [
        ("there.src", "there.src: found a folder"),
        ("none/two.src", "none/two.src: found no folder none"),
    ],
)
def test_convert_refuses_a_target_that_cannot_be_a_file(folder, capsys, target, words):
    (folder / "there.src").mkdir()
    before = names(folder)
    assert main(["convert", "part.ngc", target, "--force"]) == 2
    assert words in capsys.readouterr().err
    assert names(folder) == before


def test_convert_that_fails_leaves_nothing_and_names_its_target(
    folder, capsys, monkeypatch
):
    def full(*_):
        raise OSError(errno.ENOSPC, "no space left")

    before = names(folder)
    for function in ("replace", "rename"):
        monkeypatch.setattr(os, function, full)
    assert main(["convert", "part.ngc", "two.src"]) == 2
    error = capsys.readouterr().err
    assert "no space left: 'two.src'" in error and ".two.src" not in error
    assert names(folder) == before


def test_convert_says_which_spindle_speeds_it_leaves_out(folder, capsys):
    text = "T1 M6\nS6000 M3\nG0 X0 Y0 Z1\nG1 X5 F60\nS{}\nG1 X9\nT2 M6\nS900\nG1 X2\nM2"
    (folder / "two.ngc").write_text(text.format(8000))
    for name in ("two.tap", "two.apt", "two.src", "two.mod"):
        assert main(["convert", "two.ngc", name]) == 0
        found = capsys.readouterr().out
        assert "first spindle speed, 6000 rpm, is written; not 8000\n" in found
    assert main(["convert", "two.ngc", "two.csv"]) == 0
    (folder / "two.ngc").write_text(text.format(6000))
    assert main(["convert", "two.ngc", "two.tap", "--force"]) == 0
    assert "spindle" not in capsys.readouterr().out


def test_check_program(folder, capsys):
    assert main(["check", "part.ngc"]) == 0
    text = capsys.readouterr().out
    assert "2 rapids, 1 lines" in text
    assert "3000 mm/min" in text
    assert "x: -6.000 to -2.000 mm" in text
    (folder / "bad.ngc").write_text("G21\nG1 X1 F100\nM98 P1\n")
    assert main(["check", "bad.ngc"]) == 2
    error = capsys.readouterr().err
    assert "line 3" in error
    assert "is not in the program's file" in error


def test_check_other_files(folder, capsys):
    assert main(["check", "job.toml"]) == 0
    text = capsys.readouterr().out
    assert "tooth periods of 3.75 ms" in text
    assert "rigid" in text
    # A rigid machine has nothing to correct.
    assert re.search(r"expected: simulate about 1 s, 0\.\d\d GB; time within", text)
    (folder / "path.csv").write_text("time_s,x_mm,y_mm,z_mm\n0,0,0,0\n1,5,0,0\n")
    assert main(["check", "path.csv"]) == 0
    assert "x: 0.000 to 5.000 mm" in capsys.readouterr().out
    assert main(["check", "part.dxf"]) == 2
    assert ".csv" in capsys.readouterr().err


def expected_bytes(file, capsys):
    """Rows of a job's path, and the memory that `check` expects [byte]."""
    assert main(["check", file]) == 0
    text = capsys.readouterr().out
    found = re.search(r"(\d+) tooth per(?s:.*)s, ([\d.]+) GB; time", text)
    assert found is not None
    return int(found[1]), 1e9 * float(found[2])


@pytest.mark.slow
def test_check_counts_what_the_rows_of_a_solution_take(folder, capsys):
    """Three times over: they stay, and as much is made of them."""
    job = load_job("job.toml")
    solution = dm.simulate(job)
    leaves = jax.tree.leaves((job.path, solution))
    rows = [x for x in leaves if np.ndim(x) and len(x) == job.path.step_count]
    # A long path is kept at the tooth instants of the rigid cut alone.
    inner = solution.rigid.ends.nbytes - solution.rigid.actual.nbytes
    each = (sum(x.nbytes for x in rows) - inner) / job.path.step_count
    short, before = expected_bytes("job.toml", capsys)
    text = re.sub(r"F\d+", "F0.3", (folder / "part.ngc").read_text())
    (folder / "part.ngc").write_text(text)
    long, after = expected_bytes("job.toml", capsys)
    assert long > 100_000
    assert after - before == pytest.approx(3 * each * (long - short), rel=0.1)


def test_check_campaign_and_result(folder, capsys):
    main(["example", "tiny"])
    text = 'job = "tiny.toml"\n[[sweep]]\nkey = "spindle.speed"\n'
    pathlib.Path("sweep.toml").write_text(text + 'values = ["8000 rpm", "9000 rpm"]\n')
    pathlib.Path("result.nc").write_bytes(b"\x89HDF\r\n")
    capsys.readouterr()
    assert main(["check", "sweep.toml"]) == 0
    out = capsys.readouterr().out
    assert "2 jobs" in out and "spindle_speed: 2" in out
    assert main(["check", "result.nc"]) == 2
    assert "netCDF" in capsys.readouterr().err


def test_a_command_ends_while_a_thread_compiles(tmp_path):
    # An interrupted run leaves a compilation behind, which nothing can interrupt.
    script = (
        "import time, jax.numpy as jnp\n"
        "import diffmill.__main__ as entry\n"
        "from diffmill.numerics import CachedJit\n"
        "def long(x):\n"
        "    for _ in range(2000): x = jnp.sin(x) @ x\n"
        "    return x\n"
        "def main():\n"
        "    CachedJit(long).prepare(jnp.ones((8, 8)))\n"
        "    time.sleep(2)\n"
        "    print('error: interrupted')\n"
        "    return 1\n"
        "entry.main = main\n"
        "entry.run()\n"
    )
    done = python(script, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (1, "error: interrupted\n")
    assert done.stderr == ""


@pytest.mark.skipif(not pathlib.Path("/dev/full").exists(), reason="no /dev/full")
def test_output_that_finds_no_room_is_no_success():
    line = [sys.executable, "-m", "diffmill", "--version"]
    buffered = {k: v for k, v in os.environ.items() if k != "PYTHONUNBUFFERED"}
    with pathlib.Path("/dev/full").open("w") as full:
        done = subprocess.run(
            line, env=buffered, stdout=full, stderr=subprocess.PIPE, text=True
        )
    assert done.returncode == 1
    assert done.stderr.startswith("error: the output is not complete")


def test_an_interrupt_in_a_callback_is_not_lost():
    code = """
import gc, signal, sys, time
from diffmill.cli import main
# What was started in the background ignores interrupts.
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.argv = ["diffmill", "--version"]
main()
def callback(phase, info):
    gc.callbacks.clear()
    raise KeyboardInterrupt
gc.callbacks.append(callback)
try:
    gc.collect()
    time.sleep(5)
except KeyboardInterrupt:
    print("interrupted")
"""
    ran = python(code)
    assert ran.stdout.endswith("interrupted\n") and not ran.stderr


def test_a_script_keeps_what_it_compiles_where_commands_do(tmp_path):
    script = (
        "import jax, jax.numpy as jnp, diffmill as dm\n"
        "print(dm.use_compile_cache())\n"
        "jax.jit(lambda x: jnp.sin(x) @ x)(jnp.ones((3, 3)))\n"
    )
    home = {"XDG_CACHE_HOME": str(tmp_path / "cache"), "HOME": str(tmp_path)}
    done = python(script, env=home, check=True)
    folder = pathlib.Path(done.stdout.strip())
    assert folder == tmp_path / "cache" / "diffmill" / "jax"
    assert any(folder.iterdir())
    (tmp_path / "file").write_text("")
    for place in (tmp_path / "file", tmp_path / "file" / "below"):
        done = python(f"import diffmill as dm; dm.use_compile_cache({str(place)!r})")
        assert done.returncode == 1
        assert "Error" in done.stderr.splitlines()[-1]
        assert str(place) in done.stderr.splitlines()[-1]


@pytest.mark.parametrize("given, found", [(None, "1"), ("3", "3")])
def test_a_script_runs_on_one_thread_unless_told(tmp_path, given, found):
    script = (
        "import os, diffmill as dm\n"
        "dm.use_compile_cache()\n"
        "print(os.environ['NPROC'])\n"
    )
    home = {"XDG_CACHE_HOME": str(tmp_path), "HOME": str(tmp_path)}
    home |= {} if given is None else {"NPROC": given}
    assert python(script, env=home, check=True).stdout.strip() == found


# A constant that XLA takes seconds to fold, of which it warns in a box.
SLOW_CONSTANT = """
import jax, jax.numpy as jnp
import diffmill as dm
{}
window = lambda x: jax.lax.reduce_window(
    x, 0.0, jax.lax.add, (30, 30), (1, 1), "SAME"
)
print(jax.jit(lambda: jnp.sin(window(2 * jnp.ones((80, 80)))))().shape)
"""


@pytest.mark.slow
def test_a_slow_compilation_puts_no_box_on_the_standard_error(tmp_path):
    home = {"XDG_CACHE_HOME": str(tmp_path), "HOME": str(tmp_path)}
    # Both must compile.
    home |= {"JAX_ENABLE_COMPILATION_CACHE": "false"}
    loud, quiet = (
        python(SLOW_CONSTANT.format(call), env=home, check=True)
        for call in ("", "dm.use_compile_cache()")
    )
    assert loud.stdout == quiet.stdout == "(80, 80)\n"
    assert "slow_operation_alarm" in loud.stderr
    assert quiet.stderr == ""


def test_cache_folder_and_precision(tmp_path):
    # A job without its program: it is read for its precision first.
    (tmp_path / "job.toml").write_text(JOB + '[simulation]\nprecision = "float32"\n')
    # In a process of its own: the settings of JAX are global.
    script = (
        "import json, jax\n"
        "from diffmill.cli import main\n"
        "assert main(['simulate', 'job.toml']) == 2\n"
        "print(json.dumps([jax.config.jax_enable_x64, "
        "jax.config.jax_compilation_cache_dir]))\n"
    )
    environment = {"XDG_CACHE_HOME": str(tmp_path / "cache"), "HOME": str(tmp_path)}
    done = python(script, cwd=tmp_path, env=environment, check=True)
    is_double, cache = json.loads(done.stdout)
    assert is_double is False
    assert pathlib.Path(cache).is_relative_to(tmp_path)
