"""A stock on disk: back as it was, or one clear error."""

import numpy as np
import pytest

from diffmill import workpiece as wp


@pytest.fixture
def stock():
    made = wp.box([0, 0, -2e-3], [3e-3, 2e-3, 0], 0.25e-3)
    x, y, z = made.families
    # The upper half of one corner is gone, cut by pose 5.
    ends = z.ends.at[:8, :8, 1, 0].min(-1e-3)
    z = wp.Rays(ends, z.poses.at[:8, :8, 1].set(5))
    return wp.Stock((x, y, z), made.origin, made.spacing, made.top, (0.25, 0.25, 0.5))


def test_a_stock_comes_back_as_it_was(tmp_path, stock):
    wp.save(stock, tmp_path / "stock.npz")
    found = wp.load_stock(tmp_path / "stock.npz", is_raw=False)
    assert (found.spacing, found.top) == (stock.spacing, stock.top)
    assert found.volume_weights == stock.volume_weights
    for got, wanted in zip(found.families, stock.families, strict=True):
        np.testing.assert_array_equal(got.ends, wanted.ends)
        np.testing.assert_array_equal(got.poses, wanted.poses)


def test_raw_stock_forgets_poses_and_takes_its_highest_point(tmp_path):
    made = wp.box([0, 0, -2e-3], [3e-3, 2e-3, 0], 0.25e-3)
    x, y, z = made.families
    lines = np.asarray(made.origin[2]) + 0.25e-3 * np.arange(x.ends.shape[1])
    is_gone = lines > -0.9e-3
    dead = np.array([1e3, -1e3])[:, None]
    x = wp.Rays(x.ends.at[:, is_gone].set(dead), x.poses + 4)
    y = wp.Rays(y.ends.at[is_gone].set(dead), y.poses)
    z = wp.Rays(z.ends.at[:, :, 1].min(-0.9e-3), z.poses)
    faced = wp.Stock((x, y, z), made.origin, made.spacing, made.top)
    wp.save(faced, tmp_path / "stock.npz")
    found = wp.load_stock(tmp_path / "stock.npz")
    assert found.top == pytest.approx(-0.9e-3)
    assert all((rays.poses == -1).all() for rays in found.families)
    np.testing.assert_array_equal(found.families[2].ends, z.ends)
    single = wp.load_stock(tmp_path / "stock.npz", dtype=np.float32)
    assert single.families[0].ends.dtype == np.float32


def arrays(tmp_path, stock):
    wp.save(stock, tmp_path / "good.npz")
    with np.load(tmp_path / "good.npz") as found:
        return {name: found[name] for name in found.files}


def swap(name, change):
    def make(found):
        return {**found, name: change(found[name])}

    return make


def without(name):
    return lambda found: {k: v for k, v in found.items() if k != name}


def overlapping(ends):
    ends = ends.copy()
    ends[6, 6, :, 0], ends[6, 6, :, 1] = (0, 2e-3), (1e-3, 3e-3)
    return ends


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (without("ends_y"), "the arrays ends_y are missing"),
        (lambda found: {**found, "more": np.zeros(3)}, "more are unknown"),
        (swap("spacing", lambda a: -a), "spacing is"),
        (swap("origin", lambda a: a * np.nan), "finite"),
        (swap("origin", lambda a: a[:2]), r"origin has shape \(2,\)"),
        (swap("ends_x", lambda a: np.where(a > 1, np.nan, a)), "not finite"),
        (swap("ends_x", lambda a: a[:-1]), "ends_x and poses_x differ"),
        (swap("ends_x", overlapping), "overlap"),
        (swap("poses_z", lambda a: a.astype(float)), "poses_z holds float64"),
        (swap("ends_z", lambda a: a.astype(object)), "ends_z holds object"),
        (swap("ends_z", lambda a: a * 0), "hold material"),
        (swap("volume_weights", lambda a: a * 2), "sum to 1"),
    ],
)
def test_arrays_that_are_no_stock_are_refused(tmp_path, stock, change, message):
    changed = change(arrays(tmp_path, stock))
    if message == "hold material":
        changed["ends_x"] = changed["ends_x"] * 0
        changed["ends_y"] = changed["ends_y"] * 0
    np.savez(tmp_path / "bad.npz", **changed)
    with pytest.raises(wp.StockFileError, match=rf"bad\.npz: .*{message}"):
        wp.load_stock(tmp_path / "bad.npz")


def test_grids_that_do_not_fit_together_are_refused(tmp_path, stock):
    changed = arrays(tmp_path, stock)
    for name in ("ends_x", "poses_x"):
        changed[name] = changed[name][:-1]
    np.savez(tmp_path / "bad.npz", **changed)
    with pytest.raises(wp.StockFileError):
        wp.load_stock(tmp_path / "bad.npz")


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_a_file_cut_short_is_refused(tmp_path, stock, share):
    wp.save(stock, tmp_path / "stock.npz")
    data = (tmp_path / "stock.npz").read_bytes()
    (tmp_path / "short.npz").write_bytes(data[: int(share * len(data))])
    with pytest.raises(wp.StockFileError, match=r"short\.npz"):
        wp.load_stock(tmp_path / "short.npz")


def test_a_damaged_byte_is_noticed(tmp_path, stock):
    wp.save(stock, tmp_path / "stock.npz")
    data = bytearray((tmp_path / "stock.npz").read_bytes())
    with np.load(tmp_path / "stock.npz") as found:
        assert "ends_x" in found.files
    place = data.index(b"ends_x.npy") + 200
    data[place] ^= 0xFF
    (tmp_path / "bad.npz").write_bytes(data)
    with pytest.raises(wp.StockFileError, match=r"bad\.npz"):
        wp.load_stock(tmp_path / "bad.npz")


def test_missing_files_and_folders_are_named(tmp_path):
    with pytest.raises(wp.StockFileError, match=r"no\.npz"):
        wp.load_stock(tmp_path / "no.npz")
    with pytest.raises(wp.StockFileError):
        wp.load_stock(tmp_path)


def test_a_file_that_would_fill_the_memory_is_not_read(tmp_path, stock, monkeypatch):
    wp.save(stock, tmp_path / "stock.npz")
    monkeypatch.setattr("diffmill.workpiece._memory._memory_limit", lambda: 5e2)
    with pytest.raises(wp.StockFileError):
        wp.load_stock(tmp_path / "stock.npz")
