"""The correction through a controller: presets, and a curve over its bandwidth.

python experiments/correction/controller.py [--example paper] [--out FOLDER]
    [--presets ideal kuka_krc4_like] [--bandwidths 2 3 5 10 20] [--knots "15 ms"]
python experiments/correction/controller.py --parts thin_wall freeform [--arms ...]
    [--presets kuka_krc4_like]

An example runs through every preset and servos of every bandwidth; with `--parts`, the
small parts run on the arms through the presets.
"""

import argparse
import pathlib
import sys
import tempfile
from typing import Any

import diffmill as dm
from diffmill import examples
from diffmill.viz import case_numbers
from part_jobs import ARMS, part_job
from parts import PARTS

PRESETS = ("ideal", "kuka_krc4_like", "abb_irc5_like", "cnc_following_error")
BANDWIDTHS = (2.0, 3.0, 5.0, 8.0, 20.0)
# The parts are timed without jerks, as the examples are: the tool stops at corners.
SMOOTH = 'smoothing = "100 ms"'
CASES = ("uncorrected", "mirror", "inverse_drive", "corrected")
# What the correction is to reach against the uncorrected program and the best mirror.
BETTER, BETTER_THAN_MIRROR = 10.0, 3.0
RESULTS = pathlib.Path(__file__).parent / "results"


def write_controlled_job(
    folder: pathlib.Path, example: str, controller: str, knots: str, more: str = ""
) -> pathlib.Path:
    """Write an example job with lines of a table `[controller]`, and more lines."""
    file = examples.copy_example(example, folder)
    text = file.read_text().replace(
        'knot_spacing = "30 ms"', f'knot_spacing = "{knots}"'
    )
    file.write_text(f"{text}\n[controller]\n{controller}\n{more}")
    return file


def controlled_job(example: str, controller: str, knots: str) -> dm.Job:
    """Return an example job with lines of a table `[controller]`."""
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        return dm.load_job(write_controlled_job(folder, example, controller, knots))


def measure(
    report: Any,
    example: str = "paper_small",
    presets: tuple[str, ...] = PRESETS,
    bandwidths: tuple[float, ...] = BANDWIDTHS,
    knots: str = "30 ms",
) -> None:
    """Print all cases for every preset, then over the bandwidth of slow servos."""
    report.say(f"{example}, knots of {knots}; rms contour error in um, offset in mm")
    _head(report, "preset")
    for preset in presets:
        job = controlled_job(example, f'preset = "{preset}"', knots)
        _row(report, preset, job)
    if not bandwidths:
        return
    report.say()
    report.say("kuka_krc4_like with servos of another bandwidth")
    _head(report, "bandwidth")
    for bandwidth in bandwidths:
        controller = f'preset = "kuka_krc4_like"\nbandwidth = "{bandwidth:g} Hz"'
        _row(report, f"{bandwidth:g} Hz", controlled_job(example, controller, knots))


def measure_parts(
    report: Any, parts: tuple[str, ...], arms: tuple[str, ...], presets: tuple[str, ...]
) -> None:
    """Print all cases of the small parts on the arms through the presets."""
    for preset in presets:
        report.say(f"{preset}, knots of 30 ms; rms contour error in um, offset in mm")
        _head(report, "part and arm")
        for part in parts:
            for arm in arms:
                table = f'[controller]\npreset = "{preset}"'
                job = part_job(part, arm, robot=table, timing=SMOOTH)
                _row(report, f"{part} {arm.removesuffix('_like')}", job)
        report.say()


def _head(report: Any, what: str) -> None:
    report.say(f"{what:30}{''.join(f'{case:>15}' for case in CASES)}{'offset':>9}")


def _row(report: Any, name: str, job: dm.Job) -> None:
    """Print the cases of a job, and judge the correction."""
    found = dm.correct(job)
    data = found.to_dataset()
    rms = {case: case_numbers(data, case).contour.rms for case in CASES}
    offset = abs(found.commanded - found.before.desired).max()
    report.say(
        f"{name:30}"
        + "".join(f"{1e6 * rms[case]:15.2f}" for case in CASES)
        + f"{1e3 * float(offset):9.2f}"
    )
    gains = [rms[case] / rms["corrected"] for case in ("uncorrected", "mirror")]
    for what, gain, limit in zip(
        ("uncorrected", "mirror"), gains, (BETTER, BETTER_THAN_MIRROR), strict=True
    ):
        report.at_least(f"{name}: {what} over corrected", gain, limit)


if __name__ == "__main__":
    import jax

    jax.config.update("jax_enable_x64", True)
    dm.use_compile_cache()
    sys.path.append(str(pathlib.Path(__file__).parents[1] / "common"))
    from reporting import Report, store

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--example", default="paper_small")
    parser.add_argument("--parts", nargs="+", choices=list(PARTS))
    parser.add_argument("--arms", nargs="+", choices=ARMS, default=ARMS)
    parser.add_argument("--presets", nargs="+", choices=PRESETS)
    parser.add_argument("--bandwidths", type=float, nargs="*", default=BANDWIDTHS)
    parser.add_argument("--knots", default="30 ms")
    parser.add_argument("--out", type=pathlib.Path, default=RESULTS)
    given = parser.parse_args()
    presets = tuple(given.presets or PRESETS)
    what = "_".join(given.parts or [given.example])
    result = Report(f"diffmill correction: controller, {what}")
    if given.parts:
        measure_parts(result, tuple(given.parts), tuple(given.arms), presets)
    else:
        measure(result, given.example, presets, tuple(given.bandwidths), given.knots)
    store(result, given.out, f"controller_{what}")
