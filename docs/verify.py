"""Run the tests that hold the model against other sources, and write what they found.

    python docs/verify.py

writes `docs/verified.md`. A difference is the largest that the test compares, by
`assert_allclose` of NumPy, `approx` of pytest or the tests' own `relative`, over the
largest expected value of the same array.
"""

import functools
import importlib
import pathlib
import sys
from typing import Any, NamedTuple

import numpy as np
import pytest

ROOT = pathlib.Path(__file__).parents[1]
PAGE = ROOT / "docs" / "verified.md"
HEAD = """# How it was verified

`python docs/verify.py` runs the tests below and writes this page. A difference is the
largest that a test compares, over the largest value that is expected; where a test
has a bound, only its outcome is here. Tests with recorded data are skipped where
`DIFFMILL_REFERENCE_DATA` does not lead to them, and slow cases are left out.

A row says that the equations are solved as they are written. Whether they describe a
machine, only a measurement of that machine can show: no built-in robot is an
identified machine as a whole.
"""


class Claim(NamedTuple):
    """What a test shows.

    Attributes:
        what: The quantity.
        beside: What it is compared with.
        test: The test, as pytest names it.
        has_digits: Whether the other source has so many digits that the difference
            says something.
    """

    what: str
    beside: str
    test: str
    has_digits: bool = True


CLAIMS = {
    "Robot": [
        Claim(
            "mass matrix, bias, gravity and inverse dynamics of a KUKA KR 210",
            "Pinocchio, recorded",
            "tests/robot/test_reference.py::test_dynamics_agree_with_pinocchio",
        ),
        Claim(
            "kinematics, Jacobian, compliance and natural frequencies at several poses",
            "Pinocchio and SciPy, recorded",
            "tests/robot/test_reference.py"
            "::test_compliance_and_modes_agree_with_pinocchio_and_scipy",
        ),
        Claim(
            "stiffness and deflection under 100 N of the built-in KR 210",
            "a computation elsewhere, recorded",
            "tests/robot/test_reference.py"
            "::test_the_built_in_kr210_bends_as_computed_elsewhere",
        ),
        Claim(
            "dynamics of a planar arm",
            "closed form",
            "tests/robot/test_dynamics.py::test_planar_arm_has_its_closed_form",
        ),
        Claim(
            "natural frequencies of two masses on springs",
            "roots of det(K - w^2 M)",
            "tests/robot/test_compliance.py::test_two_masses_ring_as_in_the_textbook",
        ),
        Claim(
            "order of convergence of the integrators",
            "2 for the midpoint rule, 4 for Runge and Kutta's",
            "tests/sim/test_integrators.py"
            "::test_order_of_convergence_on_a_swinging_arm",
        ),
        Claim(
            "all terms of arms from URDF files at random states",
            "Pinocchio, run beside",
            "tests/robot/test_urdf_reference.py::test_random_states_against_pinocchio",
        ),
        Claim(
            "a mode at the tool tip after a step of force",
            "closed form",
            "tests/sim/test_modal_machine.py"
            "::test_a_step_of_force_rings_as_the_closed_form_says",
        ),
    ],
    "Chip, force and material": [
        Claim(
            "force of the linear law with an edge",
            "computed by hand",
            "tests/cutting/test_law.py::test_linear_by_hand",
        ),
        Claim(
            "force of Kienzle's law",
            "computed by hand",
            "tests/cutting/test_law.py::test_kienzle_by_hand",
        ),
        Claim(
            "chip thickness between two circles",
            "geometry of the circles",
            "tests/process/test_chip.py::test_the_chip_ends_where_the_earlier_circle_does",
        ),
        Claim(
            "mean force of partial cuts",
            "quadrature over the immersion",
            "tests/sim/test_process_alone.py::test_partial_cuts_match_the_quadrature",
        ),
        Claim(
            "area of a steady chip",
            "depth of cut times feed",
            "tests/sim/test_chip_volume.py::test_steady_chips_have_the_area_of_the_cut",
        ),
        Claim(
            "limiting depth of a chatter test: stable below, unstable above",
            "the published limit, 3 % to either side",
            "tests/sim/test_stability_limits.py"
            "::test_modes_at_the_tip_have_the_published_limits",
        ),
        Claim(
            "growth of a vibration under uneven teeth",
            "semi-discretisation over a turn",
            "tests/sim/test_stability_limits.py"
            "::test_uneven_teeth_calm_as_another_method_says",
        ),
    ],
    "Derivatives": [
        Claim(
            "slopes of the force laws",
            "finite differences",
            "tests/cutting/test_law.py::test_gradients_match_differences",
        ),
        Claim(
            "slope of the chip thickness",
            "finite differences",
            "tests/process/test_chip.py::test_chip_gradient_matches_differences",
        ),
        Claim(
            "slopes of natural frequencies and compliance",
            "finite differences",
            "tests/robot/test_compliance.py"
            "::test_gradients_of_frequencies_and_compliance",
        ),
    ],
    "Programs": [
        Claim(
            "motion of G-code programs",
            "LinuxCNC, to the digits that it prints",
            "tests/io/test_gcode_reference.py"
            "::test_accepted_program_has_the_motion_of_linuxcnc",
            has_digits=False,
        ),
        Claim(
            "duration of a line under an acceleration limit",
            "closed form",
            "tests/toolpath/test_timing.py::test_duration_of_one_line",
        ),
    ],
    "Measured data": [
        Claim(
            "force coefficients from mean forces over the feed",
            "the published fit of a measurement",
            "tests/identification/test_mean_force.py"
            "::test_the_published_line_fit_of_a_measurement",
        ),
    ],
}


class Outcomes:
    """A plugin of pytest that keeps outcomes and the largest differences.

    Attributes:
        found: Outcomes of the cases of a test, by its name.
        differences: Largest difference of a test, by its name.
    """

    def __init__(self):
        self.found: dict[str, list[str]] = {}
        self.differences: dict[str, float] = {}
        self.current = ""

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """Remember which test runs."""
        self.current = nodeid.partition("[")[0]

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Keep the outcome of a case."""
        if report.when == "call" or report.outcome != "passed":
            name = report.nodeid.partition("[")[0]
            self.found.setdefault(name, []).append(report.outcome)

    def note(self, actual: Any, expected: Any) -> None:
        """Keep the difference of two arrays of numbers if it is the largest."""
        a, b = np.asarray(actual, float), np.asarray(expected, float)
        largest = np.max(np.abs(b), initial=0.0)
        if largest > 0:
            found = float(np.max(np.abs(a - b)) / largest)
            kept = self.differences.get(self.current, 0.0)
            self.differences[self.current] = max(kept, found)

    def pytest_sessionstart(self) -> None:
        """Listen to the comparisons of the tests, which are imported from now on."""
        helpers = importlib.import_module("helpers")
        compare, relative, approx = (
            np.testing.assert_allclose,
            helpers.relative,
            pytest.approx,
        )

        @functools.wraps(compare)
        def watched(actual: Any, desired: Any, *more: Any, **options: Any) -> None:
            compare(actual, desired, *more, **options)
            self.note(actual, desired)

        @functools.wraps(relative)
        def watched_relative(found: Any, wanted: Any) -> Any:
            share = relative(found, wanted)
            self.note(1 + share, 1.0)
            return share

        @functools.wraps(approx)
        def watched_approx(expected: Any, *more: Any, **options: Any) -> Any:
            return Watched(approx(expected, *more, **options), expected, self)

        np.testing.assert_allclose = watched
        vars(helpers)["relative"] = watched_relative
        pytest.approx = watched_approx

    def row(self, claim: Claim) -> str:
        """Return a row of the table."""
        cases = self.found.get(claim.test, [])
        counts = {name: cases.count(name) for name in dict.fromkeys(cases)}
        outcome = ", ".join(f"{count} {name}" for name, count in counts.items())
        difference = self.differences.get(claim.test)
        is_shown = difference is not None and claim.has_digits
        shown = f"{difference:.0e}" if is_shown else ""
        if is_shown and not difference:
            shown = "none"
        file, _, name = claim.test.partition("::")
        return (
            f"| {claim.what} | {claim.beside} | {shown} | {outcome or 'not run'} | "
            f"`{file}`: `{name}` |"
        )


class Watched:
    """What `pytest.approx` returns, and keeps the difference where it holds.

    Attributes:
        approx: What decides.
        expected: The expected value.
        outcomes: What keeps the difference.
    """

    def __init__(self, approx: Any, expected: Any, outcomes: Outcomes):
        self.approx, self.expected, self.outcomes = approx, expected, outcomes

    def __eq__(self, actual: object) -> bool:
        """Return whether the value is near enough."""
        is_near = self.approx == actual
        if is_near and not isinstance(self.expected, dict | str):
            self.outcomes.note(actual, self.expected)
        return is_near

    def __hash__(self) -> int:
        """Return a number of this object alone."""
        return id(self)

    def __repr__(self) -> str:
        """Return what pytest shows."""
        return repr(self.approx)


def page(outcomes: Outcomes) -> str:
    """Return the page."""
    lines = [HEAD]
    for title, claims in CLAIMS.items():
        lines += [f"## {title}", ""]
        lines += ["| quantity | beside | difference | cases | test |"]
        lines += ["|---|---|---|---|---|"]
        lines += [*map(outcomes.row, claims), ""]
    return "\n".join(lines)


def main() -> int:
    """Run the tests and write the page; return pytest's exit code."""
    outcomes = Outcomes()
    tests = [claim.test for claims in CLAIMS.values() for claim in claims]
    code = pytest.main(["-q", f"--rootdir={ROOT}", *tests], plugins=[outcomes])
    PAGE.write_text(page(outcomes), encoding="utf-8")
    return int(code)


if __name__ == "__main__":
    sys.exit(main())
