"""Reports of figures that stand beside their limits, and the runner of their groups."""

import argparse
import importlib
import pathlib
import platform
import time

import jax
import numpy as np


class Report:
    """Collect plain lines and the figures that have a limit."""

    def __init__(self, title: str):
        self.lines = [title, "=" * len(title)]
        self.missed: list[str] = []

    def say(self, line: str = "") -> None:
        """Add a line, and print it at once: some groups take minutes."""
        self.lines.append(line)
        print(line, flush=True)

    def figure(self, what: str, found: float, limit: float, unit: str = "%") -> None:
        """Add a figure that may be at most `limit`."""
        self._judge(what, found, limit, unit, "<=", found <= limit)

    def at_least(self, what: str, found: float, limit: float, unit: str = "") -> None:
        """Add a figure that must be at least `limit`."""
        self._judge(what, found, limit, unit, ">=", found >= limit)

    def require(self, what: str, is_met: bool) -> None:
        """Add a statement that must be true."""
        self.say(f"  {what:62} {'yes' if is_met else 'NO: MISSED'}")
        if not is_met:
            self.missed.append(what)

    def _judge(
        self, what: str, found: float, limit: float, unit: str, sign: str, ok: bool
    ) -> None:
        verdict = "met" if ok else "MISSED"
        self.say(f"  {what:62} {found:10.3g} {unit:4} ({sign} {limit:g}) {verdict}")
        if not ok:
            self.missed.append(what)

    def text(self) -> str:
        """Return the whole report."""
        end = f"missed: {'; '.join(self.missed)}" if self.missed else "missed: none"
        return "\n".join([*self.lines, "", end, ""])


def store(report: Report, folder: pathlib.Path, name: str) -> None:
    """End a report with the versions and write it to `<name>.txt` in a folder."""
    report.say()
    report.say(f"jax {jax.__version__}, {platform.machine()}, {jax.default_backend()}")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.txt").write_text(report.text())
    print(report.text().splitlines()[-1])


def relative(found: object, wanted: object) -> float:
    """Return the length of the difference over the length of what is wanted."""
    found, wanted = np.asarray(found), np.asarray(wanted)
    return float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted))


def run_groups(
    title: str, description: str | None, groups: tuple[str, ...], out: pathlib.Path
) -> None:
    """Run the modules that the command line names, or all, and write their tables.

    Args:
        title: What the reports are called.
        description: Help of the command.
        groups: Modules with a function `measure(report)`.
        out: Folder of the tables unless `--out` names another.
    """
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("groups", nargs="*", metavar="GROUP", help=", ".join(groups))
    parser.add_argument("--out", type=pathlib.Path, default=out)
    arguments = parser.parse_args()
    unknown = set(arguments.groups) - set(groups)
    if unknown:
        parser.error(
            f"found {', '.join(sorted(unknown))}; allowed: {', '.join(groups)}"
        )
    arguments.out.mkdir(parents=True, exist_ok=True)
    missed = []
    for name in arguments.groups or groups:
        report = Report(f"{title}: {name}")
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
