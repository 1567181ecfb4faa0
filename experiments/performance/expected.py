"""What `diffmill check` says that a job will take, beside what it takes.

Every job runs twice; the second run counts, since the first one compiles.
"""

import contextlib
import io
import pathlib
import re
import tempfile
import time

import jax

from diffmill import config, simulate
from diffmill.cli import main
from diffmill.examples import copy_example
from reporting import Report

# Keys of the small example that decide what a row costs.
VARIANTS = {
    "as it is": {},
    "spacing 0.4 mm": {"stock.spacing": "0.4 mm"},
    "spacing 0.1 mm": {"stock.spacing": "0.1 mm"},
    "helix 30 deg": {"cutter.helix_angle": "30 deg"},
    "ball": {"cutter.kind": "ball"},
    "bull": {"cutter.kind": "bull", "cutter.corner_radius": "1 mm"},
    "tool tilts": {"simulation.tool_tilt": "true"},
    "adaptive": {"simulation.resolution": "adaptive"},
}
UNITS = {"s": 1, "min": 60, "h": 3600}


def measure(report: Report) -> None:
    """Print the time of a run, the expected one, and their ratio, larger over less."""
    with tempfile.TemporaryDirectory() as folder:
        for name, changes in VARIANTS.items():
            file = copy_example("paper_small", pathlib.Path(folder))
            text = file.read_text(encoding="utf-8")
            file.write_text(with_keys(text, changes), encoding="utf-8")
            told, taken = expected(file), measured(file)
            report.say(f"{name}: {taken:.2f} s, expected {told:.2g} s")
            report.figure(name, max(taken / told, told / taken), 3, "x")
            for other in file.parent.iterdir():
                other.unlink()


def with_keys(text: str, changes: dict[str, str]) -> str:
    """Return a job with other values at some keys."""
    for key, value in changes.items():
        table, name = key.split(".")
        written = value if value == "true" else f'"{value}"'
        text = re.sub(rf"^{name} = .*\n", "", text, flags=re.MULTILINE)
        if f"[{table}]" not in text:
            text += f"\n[{table}]\n"
        text = text.replace(f"[{table}]\n", f"[{table}]\n{name} = {written}\n")
    return text


def expected(file: pathlib.Path) -> float:
    """Return what `diffmill check` says that a simulation takes [s]."""
    with contextlib.redirect_stdout(io.StringIO()) as said:
        assert main(["check", str(file)]) == 0
    found = re.search(r"simulate about ([\d.]+) (\w+)", said.getvalue())
    assert found is not None
    number, unit = found.groups()
    return float(number) * UNITS[unit]


def measured(file: pathlib.Path) -> float:
    """Return what a simulation takes after a first one [s]."""
    job = config.load_job(file)
    jax.block_until_ready(simulate(job).actual)
    start = time.perf_counter()
    jax.block_until_ready(simulate(job).actual)
    return time.perf_counter() - start
