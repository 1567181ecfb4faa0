"""A checkpoint is whole, or refused for the one before; another job's is refused."""

import pathlib

import numpy as np
import pytest

from diffmill import io, workpiece as wp

ARRAYS = {
    "a/b": np.arange(5.0),
    "text": np.array(["one", "two"]),
    "flag": np.asarray(True),
    "none": np.zeros((0, 3), np.float32),
}


@pytest.fixture
def file(tmp_path):
    """Two checkpoints, the older one kept."""
    path = tmp_path / "run.checkpoint"
    for count in (1, 2):
        checkpoint(path).write({**ARRAYS, "count": np.asarray(count)})
    return path


def checkpoint(path, job="job"):
    return io.CheckpointFile(path, job)


def latest(path, job="job"):
    arrays, notes, _ = checkpoint(path, job).latest()
    assert arrays is not None
    return dict(arrays), notes


def test_a_checkpoint_comes_back_as_it_was(file):
    arrays, notes = latest(file)
    assert notes == ()
    assert arrays.pop("count") == 2
    assert sorted(arrays) == sorted(ARRAYS)
    for name, wanted in ARRAYS.items():
        np.testing.assert_array_equal(arrays[name], wanted)
        assert arrays[name].dtype == wanted.dtype
    assert sorted(p.name for p in file.parent.iterdir()) == [
        "run.checkpoint",
        "run.checkpoint.previous",
    ]


@pytest.mark.parametrize("at", [0, 40, 90, 700, -1])
def test_a_damaged_one_is_refused_and_the_one_before_used(file, at):
    data = bytearray(file.read_bytes())
    data[at] ^= 1
    file.write_bytes(bytes(data))
    arrays, notes = latest(file)
    assert arrays["count"] == 1
    assert "damaged" in notes[0]
    assert str(file) in notes[0]
    assert "before it is used" in notes[1]
    # What goes on from there must not push the whole one out by the damaged one.
    checkpoint(file).write({"count": np.asarray(3)})
    file.write_bytes(b"")
    assert latest(file)[0]["count"] == 1


@pytest.mark.parametrize("length", [0, 10, 200, -1])
def test_a_cut_off_one_is_refused(file, length):
    file.write_bytes(file.read_bytes()[:length])
    assert latest(file)[0]["count"] == 1
    checkpoint(file).previous.write_bytes(b"")
    with pytest.raises(ValueError, match=r"run\.checkpoint"):
        latest(file)


def test_a_digit_of_the_format_that_has_changed_is_damage(file):
    data = file.read_bytes()
    file.write_bytes(data.replace(b"checkpoint 5 ", b"checkpoint 4 ", 1))
    assert latest(file)[0]["count"] == 1


def test_a_run_killed_between_two_renames_goes_on_from_the_one_before(file):
    file.rename(file.with_name("run.checkpoint.writing"))
    assert latest(file)[0]["count"] == 1


def test_another_job_or_format_is_refused(file, monkeypatch):
    with pytest.raises(ValueError, match=r"run\.checkpoint"):
        latest(file, job="other")
    with monkeypatch.context() as patch:
        patch.setattr("diffmill.io._checkpoint._VERSION", 6)
        with pytest.raises(ValueError, match=r"5.* 6"):
            latest(file)
    monkeypatch.setattr("diffmill.io._checkpoint._versions", lambda: "jax 0")
    with pytest.raises(ValueError, match="jax 0"):
        latest(file)


@pytest.fixture
def long(tmp_path):
    """Two checkpoints of a run that adds rows."""
    path, parts = tmp_path / "run.checkpoint", ()
    for count in (1, 2):
        rows = {f"rows/{count}": np.full(4, count)}
        parts += (checkpoint(path).add_part(rows),)
        checkpoint(path).write({"count": np.asarray(count)}, parts)
    return path


def part_with(path, count):
    """The file that holds the rows of a checkpoint."""
    name = checkpoint(path).latest().parts[count - 1]
    return path.with_name("run.checkpoint.parts") / name


def test_parts_come_back_with_the_checkpoint_that_lists_them(long):
    checkpoint(long).add_part({"rows/3": np.zeros(1)})
    arrays, notes = latest(long)
    assert notes == () and len(arrays) == 3
    assert sorted(arrays) == ["count", "rows/1", "rows/2"]
    for count in (1, 2):
        np.testing.assert_array_equal(arrays[f"rows/{count}"], np.full(4, count))
    assert arrays["count"] == 2 and "rows/3" not in arrays
    checkpoint(long).remove()
    assert not any(long.parent.iterdir())


@pytest.mark.parametrize("is_there", [True, False])
def test_a_damaged_part_takes_its_checkpoint_away(long, is_there):
    first, second = part_with(long, 1), part_with(long, 2)
    for file, found in ((second, "before it is used"), (first, "no other checkpoint")):
        if is_there:
            data = bytearray(file.read_bytes())
            data[len(data) // 2] ^= 1
            file.write_bytes(bytes(data))
        else:
            file.unlink()
        if file == second:
            arrays, notes = latest(long)
            assert sorted(arrays) == ["count", "rows/1"]
            assert str(file) in notes[0] and found in notes[1]
            continue
        with pytest.raises(ValueError, match=found):
            latest(long)


def test_there_may_be_none(tmp_path):
    path = tmp_path / "run.checkpoint"
    assert checkpoint(path).latest() == (None, (), ())
    assert not checkpoint(path).exists()


def test_removing_leaves_nothing(file):
    assert checkpoint(file).exists()
    checkpoint(file).remove()
    assert not any(file.parent.iterdir())


def fingerprint(job):
    return io.CheckpointFile.of_job(pathlib.Path(), job).job_fingerprint


def test_a_fingerprint_sees_every_byte():
    stock = lambda top: wp.box([0, 0, 0], [2e-3, 2e-3, top], 0.5e-3)
    first = fingerprint(stock(2e-3))
    assert first == fingerprint(stock(2e-3))
    assert first != fingerprint(stock(np.nextafter(2e-3, 1)))
    assert fingerprint(("ab", "c")) != fingerprint(("a", "bc"))
    assert fingerprint(np.zeros(2, np.float32)) != fingerprint(np.zeros(1))
    with pytest.raises(TypeError):
        fingerprint(object())
