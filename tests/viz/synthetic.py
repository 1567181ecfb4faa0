"""A made-up result: a rounded square, milled by an arm that gives way smoothly."""

import numpy as np
import xarray

from diffmill.sim import ToothChip
from diffmill.viz import CutDexels, ForceTrace
from diffmill.workpiece import SurfaceError

PERIOD = 3.75e-3
SCALES = {
    "uncorrected": 1.0,
    "mirror": 0.45,
    "mirror_iterated": 0.7,
    "inverse_drive": 0.16,
    "corrected": 0.017,
}


def rounded_square(side=0.020, radius=0.002, pitch=0.1875e-3):
    """Tip positions at equal arc length, in the plane z = -1 mm."""
    half, quarter = side / 2 - radius, np.pi / 2
    corners = [(half, half), (-half, half), (-half, -half), (half, -half)]
    points = []
    for index, (x, y) in enumerate(corners):
        angle = np.linspace(index * quarter, (index + 1) * quarter, 60)
        points.append(
            np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle)], 1)
        )
    line = np.concatenate([*points, points[0][:1]])
    length = np.concatenate(
        [[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))]
    )
    at = np.arange(0.0, length[-1], pitch)
    plane = np.stack([np.interp(at, length, line[:, k]) for k in (0, 1)], 1)
    return np.concatenate([plane, np.full((at.size, 1), -1e-3)], axis=1)


def one_case(scale):
    """Desired path, deviation, force and volume; the ends of the path are air."""
    desired = rounded_square()
    count = desired.shape[0]
    time = PERIOD * np.arange(count)
    is_cutting = (np.arange(count) > 15) & (np.arange(count) < count - 10)
    tangent = np.gradient(desired, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    outward = np.stack([tangent[:, 1], -tangent[:, 0], 0 * time], 1)
    wave = 1.0 + 0.5 * np.sin(2 * np.pi * 9.0 * time) * np.exp(-((time % 0.4) / 0.12))
    deviation = 1.2e-4 * outward * wave[:, None] + np.array([2e-5, 0.0, 9e-5])
    deviation = scale * deviation * is_cutting[:, None]
    force = (np.array([[-40.0, 70.0, 12.0]]) + 25 * tangent) * is_cutting[:, None]
    return {
        "time": (("step",), time, {"units": "s"}),
        "desired": (("step", "axis"), desired, {"units": "m"}),
        "commanded": (("step", "axis"), desired - 0.5 * deviation, {"units": "m"}),
        "actual": (("step", "axis"), desired + deviation, {"units": "m"}),
        "force": (("step", "axis"), force, {"units": "N"}),
        "removed_volume": (("step",), 1.9e-9 * is_cutting, {"units": "m^3"}),
        "deviation": (("step", "axis"), deviation, {"units": "m"}),
        "contour_error": (("step",), np.sum(deviation * outward, 1), {"units": "m"}),
        "is_cutting": (("step",), is_cutting),
    }


def simulated():
    """A result of `simulate`."""
    return xarray.Dataset(
        one_case(1.0),
        coords={"axis": ["x", "y", "z"]},
        attrs={
            "job": "rounded square",
            "source": '[spindle]\nspeed = "8000 rpm"\n# <b>not markup</b>',
            "versions": "python 3.x, diffmill 0.0-test",
            "substeps": 8,
        },
    )


def corrected():
    """A result of `correct`: five cases and what they cost."""
    cases = [
        xarray.Dataset(one_case(scale), coords={"axis": ["x", "y", "z"]})
        for scale in SCALES.values()
    ]
    dataset = xarray.concat(
        cases,
        dim="case",
        data_vars=["commanded", "actual", "force", "deviation", "contour_error"],
        coords="minimal",
        compat="override",
        combine_attrs="override",
    ).assign_coords(case=list(SCALES))
    dataset.attrs = dict(simulated().attrs)
    for name, seconds in zip(SCALES, (0.4, 0.9, 12.0, 1.3, 31.0), strict=True):
        dataset.attrs[f"{name}_wall_time_s"] = seconds
        dataset.attrs[f"{name}_products"] = 59 if name == "corrected" else 0
    dataset.attrs["mirror_iterated_cutoff_hz"] = 3.0
    dataset.attrs["corrected_case"] = "corrected"
    return dataset


def force_record(samples_per_tooth=32):
    """A half-sine per tooth on a slow ramp, 90 degrees apart in x and y."""
    dataset = simulated()
    end = float(dataset["time"][-1])
    count = int(end / PERIOD) * samples_per_tooth
    time = np.arange(count) * PERIOD / samples_per_tooth
    phase = (time / PERIOD) % 1.0 * np.pi
    level = 1.0 + 0.2 * np.sin(2 * np.pi * 2.0 * time)
    ramp = np.clip((time - 0.1) / 0.05, 0, 1) * np.clip((end - 0.1 - time) / 0.05, 0, 1)
    force = np.stack(
        [
            -120 * np.sin(phase) * np.cos(phase) - 35 * np.sin(phase) ** 2,
            110 * np.sin(phase) ** 2 + 20 * np.sin(phase) * np.cos(phase),
            12 * np.sin(phase),
        ],
        axis=1,
    )
    return ForceTrace(time, force * (level * ramp)[:, None], PERIOD)


def chip_chart(element_count=5):
    """The circular chip h = f sin(phi), its entry delayed with the height."""
    phi = np.linspace(0.0, 2 * np.pi, 360, endpoint=False)
    height = (np.arange(element_count) + 0.5) * 0.2e-3
    start = 0.15 * np.arange(element_count)[:, None]
    weight = ((phi[None] > start) & (phi[None] < np.pi - 0.2 + 0 * start)).astype(float)
    chip = np.maximum(0.1875e-3 * np.sin(phi), 0.0)[None] * np.ones((element_count, 1))
    return ToothChip(phi, height, chip, weight)


def floor_waves():
    """Grid of the ring that the tool sweeps, and the waves on it."""
    x, y = np.meshgrid(
        np.arange(-0.018, 0.018, 0.2e-3), np.arange(-0.016, 0.016, 0.2e-3)
    )
    from_line = np.abs(np.maximum(np.abs(x), np.abs(y)) - 0.010)
    wave = 9e-5 + 3e-5 * np.sin(900.0 * x) * np.cos(700.0 * y)
    is_cut = from_line < 0.005
    return x[is_cut], y[is_cut], wave[is_cut]


def surface_error(scale=1.0):
    """Waves on the floor of the ring, and a wall across x with an error of its own."""
    x, y, wave = floor_waves()
    floor = np.stack([x, y, np.full_like(x, -1e-3)], 1)
    side, height = np.meshgrid(np.arange(-0.016, 0.016, 0.2e-3), [-0.9e-3, -0.5e-3])
    wall = np.stack([np.full(side.size, 0.015), side.ravel(), height.ravel()], 1)
    counts = [len(floor), len(wall)]
    return SurfaceError(
        points=np.concatenate([floor, wall]),
        error=scale * np.concatenate([wave, np.full(len(wall), -4e-5)]),
        normal=np.repeat([[0.0, 0, 1], [-1.0, 0, 0]], counts, axis=0),
        is_floor=np.repeat([True, False], counts),
        is_cut=np.ones(sum(counts), bool),
        family=np.repeat([2, 0], counts),
    )


def cut_dexels():
    """Floor of the ring at z = -1 mm and its two outer walls across x."""
    x, y, wave = floor_waves()
    ideal = np.stack([x, y, np.full_like(x, -1e-3)], 1)
    floor = ideal + np.stack([0 * wave, 0 * wave, wave], 1)
    y, z = np.meshgrid(np.unique(y), np.arange(-0.9e-3, 0.0, 0.2e-3))
    side = np.stack([np.full(y.size, 0.015), y.ravel(), z.ravel()], 1)
    both = np.concatenate([side, side * np.array([-1.0, 1.0, 1.0])])
    wall = both.copy()
    wall[:, 0] += 8e-5 + 3e-5 * np.sin(800 * wall[:, 1]) + 1e-2 * wall[:, 2]
    return CutDexels(floor, ideal, wall, both, 0.2e-3)
