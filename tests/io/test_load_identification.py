"""Files for `diffmill identify`: what they hold is read, what is wrong is listed."""

from typing import Any

import numpy as np
import pytest

from diffmill import JobError, config
from small_job import arm_text, body, slide

HEAD = """kind = "force_records"
[cutter]
diameter = "10 mm"
teeth = 2
[spindle]
speed = "6000 rpm"
[cut]
axial_depth = "2 mm"
[[record]]
file = "cut.txt"
feed_per_tooth = "0.1 mm"
"""
MEANS = HEAD.replace("force_records", "mean_forces").partition("[[record]]")[0]
MEANS += "[means]\n"
RATE, IDLE, CUT = 4000.0, 0.3, 1.2
SLIDES = arm_text(
    {"kind": "revolute", "name": "turn", "axis": [0, 0, 1], "stiffness": "1e5 N*m/rad"}
    | {"lower": "-180 deg", "upper": "180 deg"},
    {"kind": "translation", "position": ["500 mm", "0 mm", "0 mm"]},
    slide("slide", 0, lower="-1 m", upper="1 m", stiffness="4 N/um"),
    body("10 kg"),
    name="slides",
)
SECOND = '[[record]]\nfile = "two.txt"\nfeed_per_tooth = "0.2 mm"\n'


def forces(cuts=1):
    """Return time and force: idle, a cut at 200 teeth a second, idle, and again."""
    one = np.arange(0, 2 * IDLE + CUT, 1 / RATE)
    on = (one >= IDLE) & (one < IDLE + CUT)
    teeth = 60 + 50 * np.sin(2 * np.pi * 200 * one)
    wave = np.where(on, teeth, 0.0)
    force = np.column_stack([wave, -0.5 * wave, 0.2 * wave])
    force = np.tile(force, (cuts, 1))
    time = np.arange(len(force)) / RATE
    noise = np.random.default_rng(0).normal(size=force.shape)
    return time, force + noise + np.array([3.0, -2.0, 5.0])[None] + time[:, None]


def text(time, force, row="{:.5f};{:.3f};{:.3f};{:.3f}", head="t;Fx;Fy;Fz\ns;N;N;N\n"):
    lines = [row.format(t, *f) for t, f in zip(time, force, strict=True)]
    return head + "\n".join(lines) + "\n"


def load(folder, job=HEAD, data=None, **options) -> Any:
    time, force = forces()
    content = text(time, force) if data is None else data
    raw = content if isinstance(content, bytes) else content.encode()
    (folder / "cut.txt").write_bytes(raw)
    (folder / "file.toml").write_text(job)
    task: Any = config.load_identification(folder / "file.toml", **options)
    return task


def test_offset_drift_cut_and_entry_are_found(tmp_path):
    record = load(tmp_path).records[0]
    # 20 mm a second: 0.275 s until a radius and a tenth of 5 mm is passed.
    np.testing.assert_allclose(record.start, IDLE + 0.275, atol=0.02)
    np.testing.assert_allclose(record.stop, IDLE + CUT - 0.275, atol=0.02)
    inside = (record.record.time > record.start) & (record.record.time < record.stop)
    mean = record.record.force[inside].mean(axis=0)
    np.testing.assert_allclose(mean, [60.0, -30.0, 12.0], atol=0.6)
    assert any("Offset and drift" in note for note in record.notes)


TIME, FORCE = forces()
SHUFFLED = np.concatenate(
    np.random.default_rng(1).permutation(np.arange(len(TIME)).reshape(-1, 450))
)


@pytest.mark.parametrize(
    ("data", "more"),
    [
        ("\ufeff" + text(TIME, FORCE).replace(".", ","), ""),
        (text(TIME, FORCE, head="Pr\u00fcfung\nZeit [s];Fx;Fy;Fz\n"), ""),
        (
            text(
                TIME * 1e3, FORCE / 1e3, "{}\t{}\t{}\t{}", "t_ms\tFx_kN\tFy_kN\tFz_kN\n"
            ),
            "",
        ),
        (text(TIME, FORCE, "{1}, {2}, {3}", "fs = 4 kHz\nFx,Fy,Fz\n"), ""),
        (text(TIME, FORCE, "{1}, {2}, {3}", "Fx,Fy,Fz\n"), 'rate = "4 kHz"'),
        (text(TIME, FORCE, "{:.3f},{},{},{}"), ""),
        (text(TIME[SHUFFLED], FORCE[SHUFFLED]), ""),
        (
            text(TIME, FORCE, head="t;a;b;c\n"),
            'channels = { force_x = "a", Fy = 3, Fz = "c" }',
        ),
    ],
)
def test_one_cut_in_many_spellings(tmp_path, data, more):
    job = HEAD.replace("[[record]]", "[[record]]\n" + more)
    record = load(tmp_path, job, data).records[0]
    inside = (record.record.time > record.start) & (record.record.time < record.stop)
    np.testing.assert_allclose(record.stop - record.start, CUT - 0.55, atol=0.04)
    mean = record.record.force[inside].mean(axis=0)
    np.testing.assert_allclose(mean, [60.0, -30.0, 12.0], atol=0.6)


@pytest.mark.parametrize("channel", ["tacho", "angle"])
def test_empty_cells_of_the_spindle_are_bridged(tmp_path, channel):
    turned = 200 * np.pi * TIME
    signal = np.mod(turned, 2 * np.pi)
    signal = signal if channel == "angle" else 1.0 * (signal < 0.5)
    head = f"t;Fx;Fy;Fz;{channel}\ns;N;N;N;{'rad' if channel == 'angle' else 'V'}\n"
    row = "{:.5f};{:.3f};{:.3f};{:.3f};{:.6f}"
    signal[[0, 1000, 2000, 2001, -1]] = np.nan
    written = lambda: text(TIME, np.c_[FORCE, signal], row, head)
    found = load(tmp_path, HEAD, written()).records[0]
    assert any("5 empty cells of it were bridged" in note for note in found.notes)
    # A steep pulse is known to a sample, of 9 degrees.
    off = found.angle - turned
    assert np.ptp(off) < (1e-5 if channel == "angle" else 0.2)
    if channel == "angle":
        signal[4000:4030] = np.nan
        found = load(tmp_path, HEAD, written()).records[0]
        assert any("missing for 0.00775 s" in note for note in found.notes)


def test_a_force_that_is_left_out_changes_nothing_else(tmp_path):
    time, force = forces()
    whole = load(tmp_path).records[0]
    job = HEAD + 'channels = { Fz = "none" }\n'
    one = load(tmp_path, job, text(time, force)).records[0]
    two = "t;Fx;Fy\ns;N;N\n" + "\n".join(
        f"{t:.5f};{x:.3f};{y:.3f}" for t, (x, y, _) in zip(time, force, strict=True)
    )
    other = load(tmp_path, job, two).records[0]
    assert one.record.is_measured == other.record.is_measured == (True, True, False)
    np.testing.assert_array_equal(one.record.force, other.record.force)
    np.testing.assert_array_equal(one.record.force[:, :2], whole.record.force[:, :2])
    np.testing.assert_allclose([one.start, one.stop], [whole.start, whole.stop], 0.01)
    with pytest.raises(JobError):
        load(tmp_path, job.replace("force_records", "mean_forces"), two)


def test_a_force_may_be_a_sum_of_columns(tmp_path):
    time, force = forces()
    columns = np.column_stack([0.25 * force[:, 0], 0.75 * force[:, 0], force[:, 1:]])
    data = text(time, columns, "{},{},{},{},{}", "t_s,Fx12_N,Fx34_N,Fy_N,Fz_N\n")
    job = HEAD + 'channels = { Fx = ["Fx12", "Fx34"] }'
    found, one = (
        load(tmp_path, *given).records[0] for given in ((job, data), (HEAD, None))
    )
    np.testing.assert_allclose(found.record.force, one.record.force, atol=1e-3)
    with pytest.raises(JobError, match="a list of columns to be summed"):
        load(tmp_path, HEAD + 'channels = { Fx = ["Fx12", "none"] }', data)


def test_several_cuts_are_listed_and_named(tmp_path):
    data = text(*forces(cuts=2))
    with pytest.raises(JobError, match=r"2 cuts.* 0\.\d+"):
        load(tmp_path, data=data)
    second = load(tmp_path, HEAD + "cut = 2\n", data).records[0]
    assert second.name == "cut.txt, cut 2" and second.start > 2 * IDLE + CUT
    with pytest.raises(JobError, match=r"cut: .*3.* 2 cuts"):
        load(tmp_path, HEAD + "cut = 3\n", data)


def test_cuts_that_each_begin_at_zero_are_several(tmp_path):
    """Without idle sections: nothing but the clock tells the cuts apart."""
    on = (TIME > IDLE) & (TIME < IDLE + CUT)
    time, force = TIME[on] - TIME[on][0], FORCE[on]
    data = text(np.tile(time, 3), np.tile(force, (3, 1)))
    with pytest.raises(JobError, match="3 cuts"):
        load(tmp_path, data=data)
    second = load(tmp_path, HEAD + "cut = 2\n", data).records[0]
    assert second.stop - second.start == pytest.approx(CUT - 0.55, abs=0.01)
    np.testing.assert_allclose(second.record.time[len(time)], time[-1] + 1.0)


def test_lost_samples_do_not_end_a_cut(tmp_path):
    keep = (TIME < 0.9) | (TIME > 0.91)
    record = load(tmp_path, data=text(TIME[keep], FORCE[keep])).records[0]
    np.testing.assert_allclose(record.stop - record.start, CUT - 0.55, atol=0.04)


def test_a_time_without_unit_is_suspected(tmp_path):
    data = text(1e3 * TIME, FORCE, head="t;Fx;Fy;Fz\n")
    with pytest.raises(JobError, match=r"`t`.*time = .ms.") as error:
        load(tmp_path, data=data)
    assert "found 4 samples per second" in str(error.value)
    job = HEAD + 'units = { time = "ms", force_x = "N" }\n'
    assert load(tmp_path, job, data).records[0].record.rate == pytest.approx(RATE)


def test_saturation_is_told(tmp_path):
    force = FORCE.copy()
    force[:, 0] = np.minimum(force[:, 0], 90.0)
    record = load(tmp_path, data=text(TIME, force)).records[0]
    assert record.is_saturated
    assert any("end of a channel" in note for note in record.notes)


FEED = 'feed_per_tooth = "0.1 mm"'
AFTER = 'tare_after = ["1.6 s", "1.8 s"]'


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("force_records", "forces", "kind: found 'forces'"),
        ('speed = "6000 rpm"', "", "1 speed: found nothing"),
        (FEED, "", "feed_per_tooth: found nothing"),
        ('"0.1 mm"', '"0.1"', "found '0.1' without a unit"),
        (FEED, f'{FEED}\nstart = "9 s"', "start, stop: found 9 s"),
        (FEED, f'{FEED}\nside = "up"', "radial_depth: found nothing beside"),
        (FEED, f'{FEED}\njob = "a.toml"', "job: found beside feed_per_tooth"),
        ("0.1 mm", "0.01 mm", "a tool of this radius is not fully engaged"),
        ("cut.txt", "../cut.txt", "leads outside"),
        ("cut.txt", "none.txt", "no such file"),
        (FEED, f'{FEED}\ntare = ["0 s", "1"]', "tare"),
        (FEED, f"{FEED}\n{AFTER}", "1 tare_after: "),
        (FEED, f'{FEED}\ntare = "none"\n{AFTER}', "1 tare_after: "),
        ("[cut]", "[cuts]", "cuts: found an unknown table"),
    ],
)
def test_faults_are_named(tmp_path, old, new, message):
    with pytest.raises(JobError) as error:
        load(tmp_path, HEAD.replace(old, new))
    assert message in str(error.value)


def test_all_faults_come_at_once(tmp_path):
    job = (
        HEAD + '[[record]]\nfile = "none.txt"\nfoo = 1\n[fit]\naxes = ["x", "x", "z"]\n'
    )
    job = job.replace("teeth = 2", "teeth = 0")
    with pytest.raises(JobError) as error:
        load(tmp_path, job)
    lines = "\n".join(error.value.problems)
    for part in ("teeth", "foo", "axes: found ['x', 'x', 'z']"):
        assert part in lines


def test_means_of_a_table_and_of_records_agree(tmp_path):
    (tmp_path / "two.txt").write_text(text(TIME, 1.5 * FORCE))
    job = HEAD.replace("force_records", "mean_forces") + SECOND
    task = load(tmp_path, job)
    np.testing.assert_allclose(task.feed_per_tooth, [1e-4, 2e-4])
    np.testing.assert_allclose(task.mean_force[1] / task.mean_force[0], 1.5, rtol=0.01)
    means = "fz_mm,Fx_N,Fy_N,Fz_N\n0.2,90,-45,18\n0.1,60,-30,12\n"
    (tmp_path / "means.csv").write_text(means)
    other = load(tmp_path, MEANS + 'file = "means.csv"\n')
    np.testing.assert_allclose(other.feed_per_tooth, task.feed_per_tooth)
    np.testing.assert_allclose(other.mean_force, task.mean_force, atol=1.0)


def test_units_of_means_are_given(tmp_path):
    (tmp_path / "means.csv").write_text(
        "feed,Fx,Fy,Fz\n0.2,.09,-.045,.018\n0.1,.06,-.03,.012\n"
    )
    job = MEANS + 'file = "means.csv"\n'
    job += 'channels = { feed_per_tooth = "feed" }\n'
    task = load(tmp_path, job + 'units = { feed_per_tooth = "mm", force = "kN" }\n')
    np.testing.assert_allclose(task.feed_per_tooth, [1e-4, 2e-4])
    np.testing.assert_allclose(task.mean_force[0], [60, -30, 12])
    with pytest.raises(JobError, match=r"`Fx`.*feed_per_tooth"):
        load(tmp_path, job + 'units = { Fx = "kN" }\n')


def test_keys_that_do_not_change_means_are_refused(tmp_path):
    job = MEANS + (
        'feed_per_tooth = ["0.1 mm", "0.2 mm"]\nFx = ["60 N", "90 N"]\n'
        'Fy = ["-30 N", "-45 N"]\nFz = ["12 N", "18 N"]\n'
    )
    assert len(load(tmp_path, job).feed_per_tooth) == 2
    job += (
        'units = { force = "kN" }\nchannels = { Fx = 3 }\n[fit]\nloss = "tukey"\n'
        'refine = ["radius"]\nshift_range = "5 ms"\nlowpass = "2 kHz"\n'
        "refine_speed = true\n"
    )
    with pytest.raises(JobError) as error:
        load(tmp_path, job)
    keys = sorted(line.partition(":")[0] for line in error.value.problems)
    fit = ("loss", "lowpass", "refine", "refine_speed", "shift_range")
    means = ("channels", "units")
    assert keys == [f"[fit] {k}" for k in fit] + [f"[means] {k}" for k in means]


def test_spikes_are_left_out_of_a_mean_and_counted(tmp_path):
    force = FORCE.copy()
    force[np.linspace(2500, 4500, 10).astype(int), 0] += 5e3
    (tmp_path / "two.txt").write_text(text(TIME, 1.5 * FORCE))
    job = HEAD.replace("force_records", "mean_forces") + SECOND
    task = load(tmp_path, job, text(TIME, force))
    np.testing.assert_allclose(task.mean_force[0], [60, -30, 12], atol=0.6)
    assert "10 of 64 revolutions have gross errors" in " ".join(task.records[0].notes)
    assert not any("gross errors" in note for note in task.records[1].notes)


def test_what_was_assumed_of_a_table_of_means_is_said(tmp_path):
    (tmp_path / "means.csv").write_text(
        "fz_mm,Fx,Fy_N,Fz_N\n0.2,90,-45,18\n0.1,60,-30,12\n0.3,80,,9\n"
    )
    job = MEANS + 'file = "means.csv"\n'
    task = load(tmp_path, job)
    assert len(task.feed_per_tooth) == 2
    notes = " ".join(task.notes)
    assert "`Fx` has no unit and was taken in N" in notes
    assert "Rows 3 have empty cells" in notes


LOADS = """kind = "load_tests"
[robot]
file = "arm.toml"
[load_tests]
file = "loads.csv"
"""


def loads(
    folder,
    head="turn [deg];slide [mm];Fx [N];Fy [N];Fz [N];dx [um];dy [um];dz [um]",
    job=LOADS,
    rows="0;0;100;0;0;25;0;0\n90;100;0;200;0;0;50;0\n45;0;0;100;;1;2;3\n",
) -> Any:
    (folder / "arm.toml").write_text(SLIDES)
    (folder / "loads.csv").write_text(f"table 1\n{head}\n{rows}")
    (folder / "file.toml").write_text(job)
    task: Any = config.load_identification(folder / "file.toml")
    return task


def test_load_tests_are_read_and_turned(tmp_path):
    task: Any = loads(tmp_path)
    np.testing.assert_allclose(task.q, [[0, 0], [np.pi / 2, 0.1]])
    np.testing.assert_allclose(task.wrench[1], [0, 200, 0, 0, 0, 0])
    np.testing.assert_allclose(task.displacement[1], [0, 50e-6, 0], atol=1e-12)
    assert task.rows == (1, 2) and "Rows 3" in task.notes[0]
    # In the tool, which the second pose turns by a right angle, y is -x of base.
    turned: Any = loads(tmp_path, job=LOADS + 'load_frame = "tool"\n')
    np.testing.assert_allclose(turned.wrench[1, :3], [-200, 0, 0], atol=1e-9)
    mirrored: Any = loads(
        tmp_path, job=LOADS + 'displacement_axes = ["-y", "x", "z"]\n'
    )
    np.testing.assert_allclose(mirrored.displacement[1], [-50e-6, 0, 0], atol=1e-12)


def test_poses_may_have_names(tmp_path):
    rows = "P01;0;0;100;0;0;25;0;0;ok\nP02;90;100;0;200;0;0;50;0;ok\n"
    head = "pose;turn [deg];slide [mm];Fx [N];Fy [N];Fz [N];dx [um];dy [um];dz [um];by"
    task: Any = loads(tmp_path, head, rows=rows)
    np.testing.assert_allclose(task.q, [[0, 0], [np.pi / 2, 0.1]])
    np.testing.assert_allclose(task.displacement[1], [0, 50e-6, 0], atol=1e-12)


def test_moments_of_mirrored_axes_change_their_sign_once_more(tmp_path):
    parts = ("turn [deg];slide [mm]", "Fx [N];Fy [N];Fz [N];Mx [N*m];My [N*m];Mz [N*m]")
    head = ";".join([*parts, "dx [um];dy [um];dz [um];rx [rad];ry [rad];rz [rad]"])
    rows = "0;0;1;2;3;4;5;6;10;20;30;0.1;0.2;0.3\n"
    keys = 'load_axes = ["y", "x", "z"]\ndisplacement_axes = ["y", "z", "x"]\n'
    task = loads(tmp_path, head, LOADS + keys, rows)
    np.testing.assert_allclose(task.wrench[0], [2, 1, 3, -5, -4, -6])
    np.testing.assert_allclose(
        task.displacement[0], [20e-6, 30e-6, 10e-6, 0.2, 0.3, 0.1]
    )


def test_load_tests_without_units_are_not_guessed(tmp_path):
    bare = "turn;slide [mm];Fx;Fy;Fz;dx;dy;dz"
    with pytest.raises(JobError) as error:
        loads(tmp_path, bare)
    assert 'units`, such as { joint = "deg" }' in str(error.value)
    assert 'units`, such as { displacement = "mm" }' in str(error.value)
    job = LOADS + 'units = { displacement = "um" }\n'
    task: Any = loads(tmp_path, bare.replace("turn", "turn_deg"), job)
    np.testing.assert_allclose(task.displacement[0], [25e-6, 0, 0], atol=1e-12)


def test_units_of_load_tests_are_spelled_in_many_ways(tmp_path):
    rows = "90;100;0;200;0;1;2;3;0;50;0\n45;0;0;100;0;4;5;6;1;2;3\n"
    head = "turn [{}];slide [{}];Fx [N];Fy [N];Fz [N];{};dx [{}];dy [{}];dz [{}]"
    for angle, length, moment, factor, move in (
        ("DEG", "MM", "Nm", 1.0, "UM"),
        ("Deg", "Millimeter", "N.m", 1.0, "um"),
        ("degrees", "mm", "N-m", 1.0, "Mikrometer"),
        ("Grad", "mm", "Nmm", 1e-3, "\u00b5m"),
        ("deg", "mm", "kNm", 1e3, "um"),
    ):
        moments = ";".join(f"M{axis} [{moment}]" for axis in "xyz")
        names = head.format(angle, length, moments, move, move, move)
        task: Any = loads(tmp_path, names, rows=rows)
        np.testing.assert_allclose(task.q[0], [np.pi / 2, 0.1])
        np.testing.assert_allclose(task.wrench[0, 3:], factor * np.arange(1, 4))
        np.testing.assert_allclose(task.displacement[0], [0, 50e-6, 0], atol=1e-12)
    odd = names.replace("Mx [kNm]", "Mx [N]")
    with pytest.raises(JobError, match=r"Mx.*\"3 N\*m\".*`units`"):
        loads(tmp_path, odd, rows=rows)


def test_millimetres_along_one_load_are_not_taken_for_metres(tmp_path):
    """Two of three components are small, so that no single one tells."""
    head = "turn [deg];slide [mm];Fx [N];Fy [N];Fz [N];dx;dy;dz"
    rows = "0;0;0;0;900;0.02;0.03;0.6\n90;100;0;0;800;0.03;0.02;0.5\n"
    with pytest.raises(JobError, match=r"0\.5512 m"):
        loads(tmp_path, head, rows=rows)
    # A tracker's zero is no displacement.
    far = "0;0;0;0;900;4;5;6.001\n90;100;0;0;800;4;5;6.0015\n"
    assert loads(tmp_path, head, LOADS + "has_offset = true\n", far).has_offset
    # Who has a soft arm confirms the unit.
    soft = rows.replace("0.6", "0.06").replace("0.5", "0.06")
    job = LOADS + 'units = { displacement = "m" }\n'
    assert len(loads(tmp_path, head, job, soft).rows) == 2


def test_a_component_that_was_not_measured_is_said(tmp_path):
    head = "turn [deg];slide [mm];Fx [N];Fy [N];Fz [N];dx [um];dy [um];foo"
    with pytest.raises(JobError, match="dz"):
        loads(tmp_path, head)
    task: Any = loads(tmp_path, head, LOADS + 'channels = { dz = "none" }\n')
    assert np.isnan(task.displacement[:, 2]).all()
    # In the tool too, whose axes base does not share.
    job = LOADS + 'displacement_frame = "tool"\nchannels = { dz = "none" }\n'
    turned: Any = loads(tmp_path, head, job)
    np.testing.assert_array_equal(turned.displacement, task.displacement)
    x, y = turned.displacement_frame[1].T[:2]
    np.testing.assert_allclose([x, y], [[0, 1, 0], [-1, 0, 0]], atol=1e-9)


def modes(folder, kind, more, content) -> Any:
    (folder / "data.txt").write_text(content)
    (folder / "file.toml").write_text(
        f'kind = "{kind}"\n[[{kind}]]\nfile = "data.txt"\n{more}'
    )
    return config.load_identification(folder / "file.toml")


def test_frequency_responses_in_the_units_of_analysers(tmp_path):
    f = np.arange(5.0, 60.0)
    H = f**2 / (30**2 - f**2 + 0.1j * 30 * f)
    cells = np.column_stack([f, H.real, H.imag])
    rows = "\n".join(";".join(f"{v:.8g}" for v in row) for row in cells)
    job = 'quantity = "accelerance"\n'
    for head, more, factor in (
        ("Freq [Hz];Real [g/N];Imag [g/N]", "", 9.80665),
        ("Freq [Hz];Real [(m/s^2)/N];Imag [(m/s^2)/N]", "", 1.0),
        ("Freq;Real;Imag\nHz;g/N;g/N", "", 9.80665),
        ("Freq;Real;Imag\nHz;(mm/s^2)/N;(mm/s^2)/N", "", 1e-3),
        ("Freq;Real;Imag\n[Hz];[(m/s^2)/N];[(m/s^2)/N]", "", 1.0),
        (
            "Freq;Real;Imag",
            'units = { response = "g/N", frequency = "kHz" }\n',
            9.80665,
        ),
    ):
        one = modes(
            tmp_path, "frequency_response", job + more, f"{head}\n{rows}\n"
        ).measured[0]
        np.testing.assert_allclose(one.response, factor * H, rtol=1e-6)
        scale = 1e3 if "kHz" in more else 1.0
        np.testing.assert_allclose(one.frequency, scale * f)
    with pytest.raises(JobError, match=r"`real`.* frequency, res"):
        modes(tmp_path, "frequency_response", 'units = { real = "g/N" }\n', head + rows)


def test_the_unit_of_a_ring_down_is_given(tmp_path):
    time = np.arange(0.0, 1.0, 1e-3)
    rows = "\n".join(f"{1e3 * t:g};{np.exp(-2 * t) * np.cos(90 * t):.6f}" for t in time)
    for head, more in (("t;a", 'units = { time = "ms" }\n'), ("t;a\nms;g", "")):
        one = modes(tmp_path, "ring_down", more, f"{head}\n{rows}\n").measured[0]
        np.testing.assert_allclose(one.time, time, atol=1e-9)
    with pytest.raises(JobError, match=r"`signal`.* time"):
        modes(tmp_path, "ring_down", 'units = { signal = "g" }\n', f"t;a\n{rows}\n")


@pytest.mark.parametrize("name", ["phase", "angle", "arg", "winkel"])
def test_a_phase_in_degrees_needs_its_unit(tmp_path, name):
    f = np.arange(5.0, 60.0)
    H = 1.0 / (30**2 - f**2 + 0.1j * 30 * f)
    cells = np.column_stack([f, np.abs(H), np.angle(H, deg=True)])
    rows = "\n".join(";".join(f"{v:.10g}" for v in row) for row in cells)
    head = f"Freq [Hz];Mag [m/N];{name}"
    with pytest.raises(JobError, match="the phase has no unit"):
        modes(tmp_path, "frequency_response", "", f"{head}\n{rows}\n")
    for label, more in ((f"{head} [deg]", ""), (head, 'units = { phase = "deg" }\n')):
        data = f"{label}\n{rows}\n"
        one = modes(tmp_path, "frequency_response", more, data).measured[0]
        np.testing.assert_allclose(one.response, H, rtol=1e-6)


@pytest.mark.parametrize("name", ["acceleration", "hammer"])
@pytest.mark.parametrize("order", [1, -1])
def test_the_column_beside_the_time_is_the_ring_down(tmp_path, name, order):
    time = np.arange(0.0, 1.0, 1e-3)
    signal = np.exp(-2 * time) * np.cos(90 * time)
    cells = np.column_stack([time, signal])[:, ::order]
    rows = "\n".join(f"{a:.6f},{b:.6f}" for a, b in cells)
    head = ",".join(["time_s", name][::order])
    one = modes(tmp_path, "ring_down", "", f"{head}\n{rows}\n").measured[0]
    np.testing.assert_allclose(one.time, time, atol=1e-9)
    np.testing.assert_allclose(one.signal, signal - signal.mean(), atol=1e-6)


def test_a_coupled_record_needs_a_job_with_a_robot(tmp_path):
    (tmp_path / "run.csv").write_text("t_s,a,b\n0,1,2\n0.1,2,3\n0.2,3,4\n")
    (tmp_path / "file.toml").write_text(
        'kind = "coupled"\n[coupled]\njob = "none.toml"\nfile = "run.csv"\nfoo = 1\n'
    )
    with pytest.raises(JobError, match="foo: "):
        config.load_identification(tmp_path / "file.toml")
    units = 'units = { dx = "um" }\n'
    text = (tmp_path / "file.toml").read_text().replace("foo = 1\n", units)
    (tmp_path / "file.toml").write_text(text)
    with pytest.raises(JobError) as error:
        config.load_identification(tmp_path / "file.toml")
    assert "[coupled] job: found 'none.toml', but there is no such" in str(error.value)
    assert "unit of `dx`; allowed are time, force, deviation" in str(error.value)
    (tmp_path / "file.toml").write_text(text.replace(units, ""))
    with pytest.raises(JobError, match="Fx, Fy, Fz"):
        config.load_identification(tmp_path / "file.toml")


POSES = """kind = "kinematics"
[robot]
file = "slides.toml"
[poses]
file = "poses.csv"
noise = "20 um"
"""


def load_poses(folder, head, rows, more) -> Any:
    lines = [",".join(map(str, row)) for row in rows]
    (folder / "poses.csv").write_text("\n".join([head, *lines]) + "\n")
    (folder / "slides.toml").write_text(SLIDES)
    (folder / "poses.toml").write_text(POSES + more)
    return config.load_identification(folder / "poses.toml")


def test_frames_distances_and_differences_of_poses_are_read(tmp_path):
    joints = [[90, 100], [-45, 250]]
    tips = [[1, 2, 3], [4, 5, 6]]
    angles = [[0, 0, 90], [90, 0, 0]]
    rows = np.hstack([joints, tips, angles])
    head = "turn_deg,slide_mm,x_mm,y_mm,z_mm,roll_deg,pitch_deg,yaw_deg"
    study = load_poses(tmp_path, head, rows, 'measured = "frame"\n')
    poses = study.poses
    np.testing.assert_allclose(poses.q, [[np.pi / 2, 0.1], [-np.pi / 4, 0.25]])
    np.testing.assert_allclose(poses.position, 1e-3 * np.array(tips))
    np.testing.assert_allclose(
        poses.rotation,
        [[[0, -1, 0], [1, 0, 0], [0, 0, 1]], [[1, 0, 0], [0, 0, -1], [0, 1, 0]]],
        atol=1e-15,
    )
    assert study.noise.length == pytest.approx(20e-6)
    assert study.sizes.rotation == 5e-3
    for sign, key in ((1, "actual - desired"), (-1, "desired - actual")):
        head = "q1_deg,q2_mm,tcp_x_mm,tcp_y_mm,tcp_z_mm,dx_um,dy_um,dz_um"
        more = f'difference = "{key}"\n'
        found = load_poses(tmp_path, head, np.hstack([joints, tips, tips]), more)
        wanted = (1e-3 + sign * 1e-6) * np.array(tips)
        np.testing.assert_allclose(found.poses.position, wanted, rtol=1e-12)
    more = 'measured = "distance"\nfixed_point = ["1 m", "0 m", "20 mm"]\n'
    more += '[prior]\nslide_offset = "3 mm"\n'
    rows = [[90, 100, 400], [-45, "", 300]]
    bar = load_poses(tmp_path, "turn_deg,slide_mm,length_mm", rows, more)
    np.testing.assert_allclose(bar.poses.distance, [0.4])
    np.testing.assert_allclose(bar.fixed_point, [1, 0, 0.02])
    assert bar.rows == (1,) and bar.sizes.slide_offset == pytest.approx(3e-3)
    assert any("Rows 2 have empty cells" in note for note in bar.notes)
