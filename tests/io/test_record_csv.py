"""Measured records as text, the odd ones among them."""

import numpy as np
import pytest

from diffmill import io

RATE = 10e3
COUNT = 300
TIME = np.arange(COUNT) / RATE
# Three decimals, so that the text holds the numbers exactly.
FORCE = np.round(
    100 * np.sin(2 * np.pi * 200 * TIME[:, None] + np.arange(3)[None])
    + np.random.default_rng(0).normal(size=(COUNT, 3)),
    3,
)
NAMES = "time_s,Fx_N,Fy_N,Fz_N\n"
DYNOWARE = (
    "DynoWare,Version 2.5.1.2\nPath:,C:\\Records\\\nFilename:,slot.dwd\nSetup ID:,0\n"
    "Date:, \nTime:, \nSampling rate [Hz]:,10000\nMeasuring time [s]:,50\n"
    "Samples per channel:,300\nCycle No:,1\nTime,Fx,Fy,Fz\ns,N,N,N\n"
)
ATI = "Calibration\n1 2 3 4\n5 6 7 8\n9 10 11 12\n"


def rows(delimiter=",", stamp="%.4f", decimal=".", closing="", time=TIME):
    return [
        delimiter.join([stamp % t] + [f"{f:.3f}" for f in force]).replace(".", decimal)
        + closing
        for t, force in zip(time, FORCE, strict=True)
    ]


def text(header=NAMES, **layout):
    return header + "\n".join(rows(**layout)) + "\n"


def load(tmp_path, content, **options):
    file = tmp_path / "record.txt"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    return io.load_record(file, **options)


@pytest.mark.parametrize(
    "content",
    [
        text(),
        text("Time [s],Fx [N],Fy [N],Fz [N]\n"),
        text("\n".join(["A line of words, and more"] * 500) + "\n" + NAMES),
        text("t/s;Fx/N;Fy/N;Fz/N\n", delimiter=";", decimal=","),
        text("Zeit (s)\tKraft X (N)\tKraft Y (N)\tKraft Z (N)\n", delimiter="\t"),
        text("# Time (s)  Fx (N)  Fy (N)  Fz (N)\n", delimiter="   "),
        text('"time [s]","Fx [N]","Fy [N]","Fz [N]"\n', delimiter=","),
        text("time_s,Fx_N,Fy_N,Fz_N,Comment\n", closing=","),
        text(DYNOWARE),
        text(ATI + "Time [s] Fx [N] Fy [N] Fz [N]\n", delimiter=" "),
        text("time;Fx;Fy;Fz\n[s];[N];[N];[N]\n----\n", delimiter=";"),
        text().replace("\n", "\r\n"),
        text().replace("\n", "\r"),
        text().encode("utf-16"),
        text().encode("utf-16-be"),
        b"\xef\xbb\xbf" + text().encode(),
        text("Pr\u00fcfer: M\u00fcller\n" + NAMES).encode("latin-1"),
        text(stamp="12:30:%07.4f"),
        # A calibration table that is longer than the record.
        text("1,2,3,4\n" * 200 + "End of header\n" + NAMES),
        text("Date;Time [s];Fx;Fy;Fz\n;;N;N;N\n", delimiter=";").replace(
            "\n0.", "\n21.11.2026;0."
        ),
        text("Dev1/Time [S],Dev1/Fx [N.],Dev1/Fy (N),Dev1/Fz (N)\n"),
        text("time_s|Fx_N|Fy_N|Fz_N\n", delimiter="|"),
        text("t;Fx;Fy;Fz;State\ns;N;N;N;\n", delimiter=";", closing=";OK"),
        text("Run,time_s,Fx_N,Fy_N,Fz_N\n").replace("\n0.", "\nslot A,0."),
        text("Zeit (s) Fx (N) Fy (N) Fz (N)\n", delimiter=" ", decimal=","),
        text(NAMES) + "# end of the measurement\n\nMin,-1,-2,-3\n",
    ],
)
def test_the_numbers_of_any_layout_come_back(tmp_path, content):
    record = load(tmp_path, content)
    np.testing.assert_allclose(record.time - record.time[0], TIME, atol=1e-9)
    np.testing.assert_array_equal(record.force, FORCE)
    assert record.rate == pytest.approx(RATE, rel=1e-6)
    assert not record.is_after_gap.any()
    assert not record.is_saturated.any()


def test_words_in_a_column_hide_no_number(tmp_path):
    lines = [
        f"{line};{'overload' if i == 50 else 'OK'}" for i, line in enumerate(rows(";"))
    ]
    lines[80] = lines[80].replace(";", ";OVL;", 1)
    head = "t;Fx;Fy;Fz;State\ns;N;N;N;\n"
    record = load(tmp_path, head + "\n".join(lines))
    np.testing.assert_array_equal(record.force, np.delete(FORCE, 80, axis=0))
    with pytest.raises(io.RecordError, match=r"`State` \(tacho\)"):
        load(tmp_path, head + "\n".join(lines), channels={"tacho": "State"})


def test_decimal_commas_between_blanks_are_no_columns(tmp_path):
    lines = [f"{x:.2f} {y:.2f} {z:.2f}".replace(".", ",") for x, y, z in FORCE]
    record = load(tmp_path, "Fx (N) Fy (N) Fz (N)\n" + "\n".join(lines), rate=RATE)
    np.testing.assert_allclose(record.force, FORCE, atol=0.006)


def test_signs_between_thousands_are_no_decimal_signs(tmp_path):
    # Volts of an amplifier at 100 N/V, written in mV.
    for sign, decimal in ((",", "."), (".", ",")):
        lines = []
        for t, row in zip(TIME, 1e4 * FORCE, strict=True):
            cells = [f"{v:,.0f}".replace(",", sign) + f"{decimal}0" for v in row]
            lines.append(";".join([f"{t:.4f}".replace(".", decimal), *cells]))
        content = "t;Fx;Fy;Fz\ns;mV;mV;mV\n" + "\n".join(lines)
        record = load(tmp_path, content, units={"force": "0.01 N"})
        np.testing.assert_allclose(record.force, 100 * FORCE, atol=0.01)
        np.testing.assert_allclose(record.time, TIME, atol=1e-9)


@pytest.mark.parametrize("unit", ["_V", " V", ", mV", " [pC]"])
def test_amplifiers_need_to_say_what_they_stand_for(tmp_path, unit):
    names = ",".join(f'"F{axis}{unit}"' for axis in "xyz")
    content = f"time_s,{names}\n" + "\n".join(rows())
    with pytest.raises(io.RecordError, match=r"unit of the column `Fx`.*by `units`"):
        load(tmp_path, content)
    record = load(tmp_path, content, units={"force": "100 N"})
    np.testing.assert_allclose(record.force, 100 * FORCE)


@pytest.mark.parametrize(
    ("unit", "sensitivity", "factor"),
    [
        ("V", "100 N/V", 100.0),
        ("mV", "100 N/V", 0.1),
        ("mV", "10 mV/N", 0.1),
        ("pC", "4 pC/N", 0.25),
        ("nC", "pC/N", 1e3),
        ("pC", "0.25 kN/nC", 0.25),
        ("", "4 pC/N", 0.25),
    ],
)
def test_a_column_of_an_amplifier_takes_its_sensitivity(
    tmp_path, unit, sensitivity, factor
):
    names = ",".join(f"F{axis} [{unit}]" if unit else f"F{axis}" for axis in "xyz")
    content = f"time_s,{names}\n" + "\n".join(rows())
    record = load(tmp_path, content, units={"force": sensitivity})
    np.testing.assert_allclose(record.force, factor * FORCE)
    force = record.channels[1]
    assert (force.quantity, force.column, force.unit) == ("Fx", "Fx", sensitivity)
    assert force.highest == pytest.approx(factor * FORCE[:, 0].max())
    is_assumed = any("electric unit of its sensitivity" in x for x in record.notes)
    assert is_assumed == (not unit)
    # The sum of two columns takes it as one column does.
    twice = load(
        tmp_path, content, channels={"Fx": ["Fx", "Fy"]}, units={"force": sensitivity}
    )
    np.testing.assert_allclose(twice.force[:, 0], factor * FORCE[:, :2].sum(axis=1))


@pytest.mark.parametrize(
    ("unit", "sensitivity", "message"),
    [
        ("V", "0 N/V", "a number above 0"),
        ("V", "-100 N/V", "a sign in `axes`"),
        ("V", "0 N", "a number above 0"),
        ("V", "100 mm/V", 'such as "100 N/V"'),
        ("V", "4 pC/N", "for a column in V"),
        ("N", "100 N/V", "for a column in N"),
        ("pC", "pC", 'such as "4 pC/N"'),
    ],
)
def test_a_sensitivity_that_does_not_suit_is_refused_by_its_key(
    tmp_path, unit, sensitivity, message
):
    names = ",".join(f"F{axis} [{unit}]" for axis in "xyz")
    content = f"time_s,{names}\n" + "\n".join(rows())
    with pytest.raises(io.RecordError, match=rf"unit of `force`: .*({message})"):
        load(tmp_path, content, units={"force": sensitivity})


def test_the_vertical_force_is_no_voltage(tmp_path):
    """As `F_H` beside it."""
    content = "time_s,F_x,F_H,F_V\n" + "\n".join(rows())
    record = load(tmp_path, content, channels={"Fy": "F_H", "Fz": "F_V"})
    np.testing.assert_allclose(record.force, FORCE)


def test_a_time_of_day_goes_on_after_midnight(tmp_path):
    seconds = (86400 - 0.01 + TIME) % 86400
    lines = [
        f"{int(t // 3600):02d}:{int(t % 3600 // 60):02d}:{t % 60:07.4f},{x},{y},{z}"
        for t, (x, y, z) in zip(seconds, FORCE, strict=True)
    ]
    record = load(tmp_path, NAMES + "\n".join(lines))
    np.testing.assert_array_equal(record.force, FORCE)
    np.testing.assert_allclose(record.time - record.time[0], TIME, atol=1e-9)


def test_a_date_may_name_its_time_zone(tmp_path):
    lines = rows(stamp="2024-05-01T10:00:%07.4f+02:00")
    lines[150:] = rows(stamp="2024-05-01T08:00:%07.4fZ")[150:]
    record = load(tmp_path, "time,Fx_N,Fy_N,Fz_N\n" + "\n".join(lines))
    # Seconds since 2000 have no more digits.
    np.testing.assert_allclose(record.time - record.time[0], TIME, atol=1e-6)
    np.testing.assert_array_equal(record.force, FORCE)


def test_equal_stamps_in_wrong_order_are_refused(tmp_path):
    lines = rows(stamp="%.3f")
    order = np.random.default_rng(1).permutation(COUNT)
    with pytest.raises(io.RecordError):
        load(tmp_path, NAMES + "\n".join(lines[i] for i in order))
    # Whole blocks in wrong order part no equal stamps.
    record = load(tmp_path, NAMES + "\n".join(lines[150:] + lines[:150]))
    np.testing.assert_array_equal(record.force, FORCE)


def test_a_dead_channel_is_told(tmp_path):
    lines = [f"{t:.4f},{x},7,{z}" for t, (x, _, z) in zip(TIME, FORCE, strict=True)]
    record = load(tmp_path, NAMES + "\n".join(lines))
    assert "`Fy` (Fy) is 7 in all rows: a dead channel" in record.notes[0]


@pytest.mark.parametrize("axis", range(3))
def test_a_force_that_was_not_measured_is_left_out(tmp_path, axis):
    key = "Fx Fy Fz".split()[axis]
    lines = [line.split(",") for line in rows()]
    two = NAMES.replace(f",{key}_N", "")
    two += "\n".join(",".join(line[: axis + 1] + line[axis + 2 :]) for line in lines)
    dead = NAMES + "\n".join(
        ",".join([*line[: axis + 1], "7", *line[axis + 2 :]]) for line in lines
    )
    expected = np.where(np.arange(3) == axis, 0.0, FORCE)
    for content in (two, dead):
        record = load(tmp_path, content, channels={key: None})
        np.testing.assert_array_equal(record.force, expected)
        assert record.is_measured == tuple(i != axis for i in range(3))
        assert record.names[axis] == key and not record.is_saturated.any()
    with pytest.raises(io.RecordError, match=rf'{{ {key} = "none" }}'):
        load(tmp_path, two)
    with pytest.raises(io.RecordError):
        load(tmp_path, text(), channels=dict.fromkeys(("Fx", "Fy", "Fz")))


def test_units_that_are_given_come_before_those_of_the_file(tmp_path):
    lines = rows(time=1e3 * TIME)
    units = {"time": "ms", "force": "kN", "Fz": "daN"}
    record = load(tmp_path, "t,Fx,Fy,Fz\n" + "\n".join(lines), units=units)
    np.testing.assert_allclose(record.time, TIME, atol=1e-12)
    np.testing.assert_allclose(record.force, FORCE * np.array([[1e3, 1e3, 10.0]]))
    assert not record.notes


def test_units_become_si(tmp_path):
    header = "t [ms];Fx [kN];Fy (N);Fz_lbf;Angle [deg];tacho\n"
    lines = [f"{line};90;5" for line in rows(";", stamp="%.4f", time=TIME * 1e3)]
    record = load(tmp_path, header + "\n".join(lines))
    np.testing.assert_allclose(record.time, TIME, atol=1e-12)
    scales = np.array([1e3, 1.0, 4.4482216152605])  # one pound-force, by definition
    np.testing.assert_allclose(record.force, FORCE * scales[None], rtol=1e-12)
    assert record.angle is not None and record.tacho is not None
    np.testing.assert_allclose(record.angle, np.pi / 2)
    assert record.tacho[0] == 5.0
    assert record.names == ("Fx", "Fy", "Fz")


def test_units_are_spelled_in_many_ways(tmp_path):
    for time, force in (
        ("Sekunden", "Newton"),
        ("SECONDS", "newtons"),
        ("Second", "NEWTON"),
        ("Sekunde", "Newtons"),
    ):
        names = f"Zeit in {time};Fx {force};Fy [{force}];Fz ({force})\n"
        record = load(tmp_path, text(names, delimiter=";"))
        np.testing.assert_array_equal(record.force, FORCE)
        assert not record.notes


def test_a_missing_unit_is_said_so(tmp_path):
    record = load(tmp_path, text("time_s,Fx,Fy_N,Fz_N\n"))
    assert record.notes == ("The column `Fx` has no unit and was taken in N.",)


def test_stamps_with_few_digits_are_rebuilt(tmp_path):
    # Three decimals at 10 kHz: ten rows with the same stamp.
    record = load(tmp_path, text(stamp="%.3f"))
    assert record.rate == RATE
    np.testing.assert_allclose(record.time, TIME, atol=1e-4)
    np.testing.assert_allclose(np.diff(record.time), 1 / RATE, rtol=1e-9)
    assert "too few digits" in record.notes[0]


def test_few_digits_do_not_hide_a_gap(tmp_path):
    time = np.where(np.arange(COUNT) < 150, TIME, TIME + 0.5)
    record = load(tmp_path, text(stamp="%.3f", time=time))
    assert np.flatnonzero(record.is_after_gap) == [150]
    np.testing.assert_allclose(record.time, time, atol=2e-4)


def test_stamps_of_six_digits_grow_coarse(tmp_path):
    # %g keeps six digits: steps of 0.1 ms until 100 s, of 1 ms from there on.
    time = 99.99 + TIME
    record = load(tmp_path, text(stamp="%.6g", time=time))
    assert not record.is_after_gap.any()
    np.testing.assert_allclose(record.time, time, atol=5e-4)
    np.testing.assert_allclose(np.diff(record.time), 1 / RATE, rtol=1e-6)
    np.testing.assert_array_equal(record.force, FORCE)


def test_a_row_that_was_written_twice_is_left_out(tmp_path):
    lines = rows()
    record = load(tmp_path, NAMES + "\n".join([*lines[:100], lines[99], *lines[100:]]))
    np.testing.assert_array_equal(record.time, TIME)
    np.testing.assert_array_equal(record.force, FORCE)
    assert record.notes == ("1 rows repeat the instant before and were left out.",)


def test_uneven_rounding_is_no_gap(tmp_path):
    # Steps of 1.5 of the last digit are written as 1 and 2.
    record = load(tmp_path, text(stamp="%.4f", time=TIME * 1.5))
    assert not record.is_after_gap.any()
    np.testing.assert_allclose(record.time, TIME * 1.5, atol=1e-4)


def test_one_lost_sample_is_a_gap(tmp_path):
    lines = rows()
    del lines[100]
    record = load(tmp_path, NAMES + "\n".join(lines))
    assert np.flatnonzero(record.is_after_gap) == [100]
    np.testing.assert_array_equal(record.time, np.delete(TIME, 100))


@pytest.mark.parametrize(
    "order",
    [
        np.r_[150:300, 0:150],
        np.random.default_rng(1).permutation(COUNT),
        np.arange(COUNT)[::-1],
    ],
)
def test_rows_in_wrong_order_are_sorted(tmp_path, order):
    lines = rows()
    record = load(tmp_path, NAMES + "\n".join(lines[i] for i in order))
    np.testing.assert_array_equal(record.force, FORCE)
    assert "were" in record.notes[0]


def test_cuts_that_begin_at_zero_again_follow_each_other(tmp_path):
    record = load(tmp_path, text() + text())
    np.testing.assert_array_equal(record.force, np.concatenate([FORCE, FORCE]))
    assert np.flatnonzero(record.is_after_gap) == [COUNT]
    assert any("begins again" in note for note in record.notes)


def test_cycles_with_a_header_each_are_all_read(tmp_path):
    names = "Cycle {}\nSampling rate [Hz]: 10000\nt;Fx;Fy;Fz\ns;N;N;N\n"
    lines = rows(";")
    for short in (lines[:120], [*lines[:60], "pause", *lines[60:120]]):
        first = names.format(1) + "\n".join(short) + "\n"
        record = load(tmp_path, first + text(names.format(2), delimiter=";"))
        np.testing.assert_array_equal(
            record.force, np.concatenate([FORCE[:120], FORCE])
        )
        assert np.flatnonzero(record.is_after_gap) == [120]
    # The same numbers in another unit are no part of it.
    record = load(tmp_path, first.replace("s;N", "ms;N") + text(names, delimiter=";"))
    np.testing.assert_array_equal(record.force, FORCE)
    assert "120 rows of numbers above the table were not read." in record.notes


def test_rows_without_numbers_leave_marked_gaps(tmp_path):
    lines = rows()
    stamps = [line.split(",")[0] for line in lines]
    lines[2] = f"{stamps[2]},overload,1,2"
    lines[50] = f"{stamps[50]},,1,2"
    lines[80] = f"{stamps[80]},nan,1,2"
    lines[90] = lines[90][:8]
    record = load(tmp_path, NAMES + "\n".join(lines))
    wrong = [2, 50, 80, 90]
    np.testing.assert_array_equal(record.force, np.delete(FORCE, wrong, axis=0))
    np.testing.assert_array_equal(
        np.flatnonzero(record.is_after_gap), np.array(wrong) - np.arange(4)
    )
    assert any("3 rows have an empty cell" in note for note in record.notes)
    assert any("1 lines are no rows" in note for note in record.notes)


@pytest.mark.parametrize("share", [[20, 21, 22, 23, 24], [7]])
@pytest.mark.parametrize("stamp", ["%.3f", "%.4f"])
def test_rows_without_numbers_do_not_change_the_clock(tmp_path, stamp, share):
    lines = rows(stamp=stamp)
    lost = [i for i in range(COUNT) if i % 50 in share]
    for i in lost:
        cells = lines[i].split(",")
        lines[i] = ",".join([*cells[:2], ("", "OVL")[i % 2], cells[3]])
    for head, options in ((NAMES, {}), ("Rate\n" + NAMES, {"rate": RATE})):
        record = load(tmp_path, head + "\n".join(lines), **options)
        good = np.delete(np.arange(COUNT), lost)
        assert record.rate == RATE
        np.testing.assert_allclose(np.diff(record.time), np.diff(TIME[good]), atol=1e-9)
        np.testing.assert_array_equal(record.force, FORCE[good])
        np.testing.assert_array_equal(record.is_after_gap[1:], np.diff(good) > 1)


def test_forces_beside_a_faster_channel_have_no_gaps(tmp_path):
    lines = [f"{line},1" for line in rows()]
    lines[1::2] = [f"{line.split(',')[0]},,,,0" for line in lines[1::2]]
    record = load(tmp_path, NAMES.replace("\n", ",tacho\n") + "\n".join(lines))
    np.testing.assert_array_equal(record.force, FORCE[::2])
    assert record.rate == RATE / 2 and not record.is_after_gap.any()


def test_a_clipped_channel_is_marked(tmp_path):
    clipped = np.clip(FORCE, -80.0, None)
    lines = [f"{t:.4f},{x},{y},{z}" for t, (x, y, z) in zip(TIME, clipped, strict=True)]
    record = load(tmp_path, NAMES + "\n".join(lines))
    expected = (clipped == -80.0).any(axis=1)
    assert expected.sum() > 100
    # Runs of one or two samples cannot be told from a peak.
    assert np.all(expected[record.is_saturated])
    assert np.mean(record.is_saturated[expected]) > 0.9


def test_the_rate_replaces_a_time_column(tmp_path):
    for header, options in (
        ("No,Fx_N,Fy_N,Fz_N\n", {"rate": RATE}),
        ("Sampling rate [kHz]:,10\nNo,Fx_N,Fy_N,Fz_N\n", {}),
        ("Abtastintervall: 0,1 ms\nNo,Fx_N,Fy_N,Fz_N\n", {}),
        (NAMES, {"channels": {"time": None}, "rate": RATE}),
    ):
        record = load(tmp_path, text(header), **options)
        np.testing.assert_allclose(record.time, TIME, atol=1e-12)


@pytest.mark.parametrize(
    "line",
    [
        "Sampling rate: 10'000 Hz",
        "Sampling rate: 10\u2019000 Hz",
        "Sampling rate: 10 000 Hz",
        "Sampling rate: 10\u202f000,0 Hz",
        "Sampling rate: 10,000.0 Hz",
        "Abtastrate: 10.000,0 Hz",
        "Sampling rate: 10000.000 Hz",
        "Sampling rate: 10.000 kHz",
        "Sampling rate: 0.010 MHz",
        "Sampling rate [Hz]:,10000,10000,10000",
        "Sampling rate [Hz]:,10000.0,10000.0",
        "Sampling interval: 0.100 ms",
        "Sampling time: 100 us",
        "Abtastzeit: 0,0001 s",
        # The length of the record, and a rate that has one meaning below it.
        "Sampling time: 10 s\nfs = 1e4",
        "Sampling rate: 10,000 Hz\nfs = 1e4",
    ],
)
def test_a_rate_has_signs_between_its_thousands(tmp_path, line):
    record = load(tmp_path, text(f"{line}\nNo,Fx_N,Fy_N,Fz_N\n"))
    assert record.rate == pytest.approx(RATE)


@pytest.mark.parametrize(
    "line",
    [
        "Sampling rate: 10,000 Hz",
        "Sampling rate: 25.600 Hz",
        "Sampling rate [Hz]: 512,1,2",
        "Sampling time: 10 s",
        "Abtastzeit [s]: 1,5",
    ],
)
def test_a_rate_that_may_be_another_is_asked_for(tmp_path, line):
    content = text(f"{line}\nNo,Fx_N,Fy_N,Fz_N\n")
    with pytest.raises(io.RecordError, match="give the rate"):
        load(tmp_path, content)
    assert load(tmp_path, content, rate=RATE).rate == RATE


def test_columns_are_chosen_by_name_or_number(tmp_path):
    header = "time_s;Kanal 1 [N];Kanal 2 [N];Kanal 3 [N]\n"
    for fz in ("Kanal 1", "kanal 1 [n]", 2):
        record = load(
            tmp_path,
            text(header, delimiter=";"),
            channels={"Fx": "Kanal 2", "Fy": 4, "Fz": fz},
        )
        np.testing.assert_array_equal(record.force, FORCE[:, [1, 2, 0]])
        assert record.names == ("Kanal 2", "Kanal 3", "Kanal 1")


@pytest.mark.parametrize(
    ("content", "options", "message"),
    [
        ("", {}, "no table of numbers"),
        ("hello\nworld\n", {}, "no table of numbers"),
        (bytes(range(256)) * 20, {}, "binary file"),
        (text(""), {}, "no column for Fx, Fy, Fz among 1 `column 1`"),
        (text("time_s,Fx_N,Fx_N,Fz_N\n"), {}, r"2 columns that may be Fx \(2 `Fx`, 3"),
        (text("time_s,Fx [V],Fy_N,Fz_N\n"), {}, "column `Fx` .* a force with its unit"),
        (text("No,Fx_N,Fy_N,Fz_N\n"), {}, "no sampling rate"),
        (text(decimal=","), {}, "decimal commas need another sign"),
        (text(), {"rate": 5e3}, "given as 5000 Hz, but the time column has 10000 Hz"),
        (text(), {"rate": -1.0}, "must be positive"),
        (text(), {"units": {"Mz": "N"}}, "unit of `Mz`; allowed are time, Fx"),
        (text(), {"units": {"force": "mm"}}, "the unit of `force`: found '1 mm'"),
        (text(), {"channels": {"Fx": 9}}, "from 1 to 4"),
        (text(), {"channels": {"Mz": 1}}, "allowed are time, Fx"),
        (NAMES + "0,1,2,3\n0.1,,,\n0.2,,,\n", {}, "1 complete rows"),
    ],
)
def test_faults_say_what_is_allowed(tmp_path, content, options, message):
    with pytest.raises(io.RecordError, match=message):
        load(tmp_path, content, **options)


def test_all_faults_are_told_at_once(tmp_path):
    with pytest.raises(io.RecordError) as raised:
        load(tmp_path, text("time_N,Fx [V],Fy_N,Fz [bar]\n"), channels={"Mz": 2})
    assert len(raised.value.faults) == 4


def test_an_absent_file_is_a_record_error(tmp_path):
    with pytest.raises(io.RecordError):
        io.load_record(tmp_path / "absent.csv")


def quarters(names="Fx12_N,Fx34_N,Fy14_N,Fy23_N,Fz1_N,Fz2_N,Fz3_N,Fz4_N"):
    """A table of the eight channels of a dynamometer with four sensors."""
    draw = np.random.default_rng(1)
    half = np.round(draw.normal(size=(COUNT, 2)), 3)
    quarter = np.round(draw.normal(size=(COUNT, 3)), 3)
    columns = [
        *(half[:, 0], FORCE[:, 0] - half[:, 0], half[:, 1], FORCE[:, 1] - half[:, 1]),
        *(*quarter.T, FORCE[:, 2] - quarter.sum(axis=1)),
    ]
    body = "\n".join(
        ",".join(f"{x:.3f}" for x in row) for row in np.column_stack(columns)
    )
    return f"{names}\n{body}\n"


SUMS = {"Fx": ["Fx12", "Fx34"], "Fy": ["Fy14", 4], "Fz": [5, 6, 7, 8]}


def test_the_channels_of_four_sensors_are_summed(tmp_path):
    record = load(tmp_path, quarters(), channels=SUMS, rate=RATE)
    np.testing.assert_allclose(record.force, FORCE, atol=1e-9)
    assert record.names[:2] == ("Fx12 + Fx34", "Fy14 + Fy23")


@pytest.mark.parametrize(
    ("names", "channels", "message"),
    [
        ("Fx12_N,Fx34_kN,a,b,c,d,e,f", {}, "differ in their unit: Fx12 N, Fx34 kN"),
        (None, {"Fx": ["Fx12", 1]}, "names one column twice"),
        (None, {"Fx": ["Fx12", "Fx3"]}, "Fx = 'Fx3' names no columns"),
        (None, {"time": ["Fx12", "Fx34"]}, "only those of a force are summed"),
    ],
)
def test_sums_of_what_does_not_go_together_are_refused(
    tmp_path, names, channels, message
):
    content = quarters() if names is None else quarters(names)
    with pytest.raises(io.RecordError, match=message):
        load(tmp_path, content, channels=SUMS | channels, rate=RATE)
