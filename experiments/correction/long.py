"""A long path in segments: time, memory and error over the number of rows.

Each length runs in a process of its own, so that its peak of memory is its own. The
path goes to and fro over a block, layer after layer.

python experiments/correction/long.py [--rows 10000 20000 40000] [--arm slides]
    [--steps 2] [--out FOLDER]
"""

import argparse
import json
import pathlib
import subprocess
import sys
import tempfile
import time
from typing import Any

# Enough to see the slope; `--rows 100000` takes a path as long as a real program.
ROWS = (10_000, 20_000, 40_000)
HORIZON, OVERLAP = 2000, 256
# Steps of the optimiser in a segment.
STEPS = 2
# Runs of the machine that the correction may take.
RUNS = 30
# Sizes of the block and of the cut [mm].
SIDE, STEP_OVER, DEPTH, RADIUS = 60.0, 4.0, 0.5, 5.0
# What a pass takes with the feed and acceleration of the job, and the way to the next.
ROWS_PER_PASS = 470

# Three slides as soft as an arm: a few times cheaper than six turning joints.
SLIDES = "\n".join(
    ['name = "slides"']
    + [
        f'[[elements]]\nkind = "prismatic"\nname = "{name}"\naxis = {axis}\n'
        'stiffness = "1.0e6 N/m"\ndamping = "2 kN*s/m"'
        for name, axis in (("x", [1, 0, 0]), ("y", [0, 1, 0]), ("z", [0, 0, 1]))
    ]
    + [
        '[[elements]]\nkind = "body"\nmass = "80 kg"\n'
        'inertia = ["1 kg*m^2", "1 kg*m^2", "1 kg*m^2"]',
        '[[elements]]\nkind = "tool"\nname = "tool"\n',
    ]
)


def measure(
    report: Any,
    rows: tuple[int, ...] = ROWS,
    arm: str = "reis_rv130_like",
    steps: int = STEPS,
) -> None:
    """Print what each length costs, and whether the cost is in proportion."""
    report.say(
        f"{arm}; segments of {HORIZON} rows, of which {OVERLAP} overlap; {steps} steps"
    )
    options = ["--arm", arm, "--steps", str(steps)]
    report.say(
        f"{'rows':>8}{'segments':>10}{'s':>9}{'ms/row':>9}{'runs':>7}{'GB':>8}"
        f"{'before um':>11}{'after um':>10}"
    )
    found = []
    for count in rows:
        text = subprocess.run(
            [sys.executable, __file__, "--one", str(count), *options],
            stdout=subprocess.PIPE,
            check=True,
            text=True,
        ).stdout
        case = json.loads(text.splitlines()[-1])
        found.append(case)
        each = 1e3 * case["seconds"] / case["rows"]
        report.say(
            f"{case['rows']:8d}{case['segments']:10d}{case['seconds']:9.1f}{each:9.2f}"
            f"{case['runs']:7.1f}{case['gigabytes']:8.2f}{case['before']:11.2f}{case['after']:10.2f}"
        )
    report.say(
        "s: of the segments, compilation included; runs: the same, in runs of the "
        "machine along the whole path; GB: peak of the whole job"
    )
    first, last = found[0], found[-1]
    each = [case["seconds"] / case["rows"] for case in (first, last)]
    report.figure("time per row, longest over shortest", each[1] / each[0], 1.2, "")
    report.figure("correction of the longest", last["runs"], RUNS, "runs")
    report.figure("peak of memory of the longest", last["gigabytes"], 4, "GB")
    report.at_least(
        "uncorrected over corrected, rms, longest", last["before"] / last["after"], 5
    )


def program(rows: int) -> tuple[str, float]:
    """Return G-code of about so many rows, and how deep it goes [mm]."""
    passes = max(1, round(rows / ROWS_PER_PASS))
    start, end = -RADIUS - 3, SIDE + RADIUS + 3
    per_layer = int((SIDE + RADIUS) // STEP_OVER)
    lines = ["G21 G17 G90 G94", "S8000 M3", f"G0 X{start:g} Y0 Z1"]
    for k in range(passes):
        layer, place = divmod(k, per_layer)
        y = (per_layer - 1 - place if layer % 2 else place) * STEP_OVER
        lines.append(f"G1 Y{y:g} Z{-DEPTH * (layer + 1):g} F3000")
        lines.append(f"G1 X{start if k % 2 else end:g}")
    lines += ["M5", "M2"]
    return "\n".join(lines) + "\n", DEPTH * (1 + (passes - 1) // per_layer)


def one(rows: int, arm: str, steps: int) -> dict[str, float]:
    """Correct one path and return its figures."""
    import resource

    import diffmill as dm
    from part_jobs import job_text

    text, depth = program(rows)
    lower, upper = (0.0, 0.0, -depth - 2), (SIDE, SIDE, 0.0)
    with tempfile.TemporaryDirectory() as folder:
        here = pathlib.Path(folder)
        (here / "part.ngc").write_text(text)
        (here / "slides.toml").write_text(SLIDES)
        settings = {
            "horizon": f"{HORIZON}",
            "overlap": f"{OVERLAP}",
            "max_steps": f"{steps}",
        }
        (here / "job.toml").write_text(
            job_text(arm, "flat", lower, upper, correction=settings, spacing_mm=0.5)
        )
        job = dm.load_job(here / "job.toml")
    began = time.perf_counter()

    def tell(message: str, rms: float) -> None:
        seconds = time.perf_counter() - began
        print(f"{seconds:8.0f} s  {message}: {1e6 * rms:.2f} um", file=sys.stderr)

    found = dm.correct(job, on_progress=tell)
    corrected = found.methods["corrected"]
    # Linux counts kilobytes, macOS bytes.
    unit = 1 if sys.platform == "darwin" else 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit
    return {
        "rows": job.path.step_count,
        "segments": int(corrected.detail.get("segment_count", 1)),
        "seconds": found.wall_time["corrected"],
        # The inverse drive is one run, and hardly more.
        "runs": found.wall_time["corrected"] / found.wall_time["inverse_drive"],
        "gigabytes": peak / 1e9,
        "before": 1e6 * found.methods["uncorrected"].measures.rms,
        "after": 1e6 * corrected.measures.rms,
    }


def main() -> None:
    """Run one length, or the group with other lengths."""
    import jax

    import diffmill

    jax.config.update("jax_enable_x64", True)
    diffmill.use_compile_cache()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, nargs="+", default=ROWS)
    parser.add_argument("--arm", default="reis_rv130_like")
    parser.add_argument("--steps", type=int, default=STEPS)
    results = pathlib.Path(__file__).parent / "results"
    parser.add_argument("--out", type=pathlib.Path, default=results)
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one is not None:
        print(json.dumps(one(arguments.one, arguments.arm, arguments.steps)))
        return
    here = pathlib.Path(__file__).parent
    sys.path.append(str(here.parent / "common"))
    from reporting import Report, store

    report = Report("diffmill correction: long")
    print("\n".join(report.lines), flush=True)
    measure(report, tuple(arguments.rows), arguments.arm, arguments.steps)
    lengths = "_".join(str(rows) for rows in arguments.rows)
    store(report, arguments.out, f"long_{arguments.arm}_{lengths}")


if __name__ == "__main__":
    main()
