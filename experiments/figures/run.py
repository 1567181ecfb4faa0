"""Run all groups of figures, or those named, and write their tables.

python experiments/figures/run.py [accuracy depth volume ...] [--out FOLDER]
"""

import argparse
import importlib
import pathlib
import platform
import time

import jax

from shared import Report

GROUPS = (
    "accuracy",
    "depth",
    "volume",
    "coupling",
    "gradient",
    "integrator",
    "speed",
    "paper",
)


def main() -> None:
    """Run the groups one after the other."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("groups", nargs="*", metavar="GROUP", help=", ".join(GROUPS))
    default = pathlib.Path(__file__).parent / "results"
    parser.add_argument("--out", type=pathlib.Path, default=default)
    arguments = parser.parse_args()
    unknown = set(arguments.groups) - set(GROUPS)
    if unknown:
        parser.error(
            f"found {', '.join(sorted(unknown))}; allowed: {', '.join(GROUPS)}"
        )
    arguments.out.mkdir(parents=True, exist_ok=True)
    missed = []
    for name in arguments.groups or GROUPS:
        report = Report(f"diffmill figures: {name}")
        print("\n".join(report.lines), flush=True)
        start = time.perf_counter()
        importlib.import_module(name).measure(report)
        report.say()
        report.say(
            f"{time.perf_counter() - start:.0f} s, jax {jax.__version__}, "
            f"{platform.machine()}, {jax.default_backend()}"
        )
        (arguments.out / f"{name}.txt").write_text(report.text())
        missed += [f"{name}: {what}" for what in report.missed]
    print("\nmissed:" if missed else "\nmissed: none")
    print("\n".join(f"  {what}" for what in missed))


if __name__ == "__main__":
    main()
