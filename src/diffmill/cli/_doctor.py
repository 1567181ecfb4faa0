"""The installation: versions, devices, cache, and a test against physics."""

import importlib.util
import math
import os
import pathlib
import platform
import sys
import time
from importlib import metadata
from typing import NamedTuple

from .._jax_config import cache_folder, configure_jax
from ._session.progress import Progress

_PACKAGES = ("diffmill", "jax", "jaxlib", "numpy", "scipy", "equinox", "xarray")
# Extra of diffmill that brings an optional module.
_EXTRAS = {
    "distributed": "campaign",
    "nptdms": "forces",
    "pymatreader": "forces",
    "jupyterlab": "notebook",
}
# Begins the line of a check that is not good.
_FAILED = "FAILED"


class Check(NamedTuple):
    """A quantity beside what it must be.

    Attributes:
        name: Name of the quantity.
        found: Value that diffmill computes.
        expected: Value of a closed form.
        tolerance: Relative difference that is allowed.
    """

    name: str
    found: float
    expected: float
    tolerance: float

    @property
    def is_good(self) -> bool:
        """True if the two agree; a number that is not finite does not."""
        error = abs(self.found - self.expected)
        return error <= self.tolerance * abs(self.expected)

    @property
    def line(self) -> str:
        """Line of the report."""
        return (
            f"{'ok' if self.is_good else _FAILED} {self.name}: {self.found:.6g}, "
            f"expected {self.expected:.6g} within {100 * self.tolerance:g} %"
        )


def run_doctor(*, is_quiet: bool) -> int:
    """Print what is installed and test it; return the exit code, 1 for a failed test.

    Args:
        is_quiet: True to print failures alone.
    """
    configure_jax()
    progress = Progress(is_quiet=is_quiet)
    report, failed = _installed(), 0
    with progress:
        for test in (arm_checks, slot_checks):
            about = (test.__doc__ or "").splitlines()[0]
            progress.update(f"self-test: {about}")
            start = time.perf_counter()
            try:
                lines = [check.line for check in test()]
            except Exception as error:
                lines = [f"{_FAILED} {test.__name__}: {type(error).__name__}: {error}"]
            failed += any(line.startswith(_FAILED) for line in lines)
            report += [*lines, f"that took {time.perf_counter() - start:.1f} s"]
    report.append("found something wrong" if failed else "found nothing wrong")
    for line in report:
        if line.startswith(_FAILED):
            print(f"error: {line}", file=sys.stderr)
        elif not is_quiet:
            print(line)
    return int(failed > 0)


def _installed() -> list[str]:
    """Lines about versions, devices, extras and the compile cache."""
    import jax

    versions = ", ".join(f"{name} {metadata.version(name)}" for name in _PACKAGES)
    devices = ", ".join(f"{d.platform} {d.device_kind}" for d in jax.devices())
    extras = ", ".join(
        f"{name} ({extra}) {'there' if importlib.util.find_spec(name) else 'absent'}"
        for name, extra in _EXTRAS.items()
    )
    return [
        f"python {platform.python_version()} on {platform.platform()}, "
        f"{os.cpu_count()} cores",
        f"versions: {versions}",
        f"devices: {devices}",
        f"optional: {extras}",
        _cache_line(),
    ]


def _cache_line() -> str:
    """Line on the folder of compiled programs, their number and size."""
    given = os.environ.get("JAX_COMPILATION_CACHE_DIR")
    folder = cache_folder() if given is None else pathlib.Path(given)
    if not folder.is_dir():
        return f"compile cache: {folder}, absent: every program is compiled anew"
    sizes = [file.stat().st_size for file in folder.glob("*") if file.is_file()]
    can = "" if os.access(folder, os.W_OK) else ", which cannot be written to"
    return (
        f"compile cache: {folder}, {len(sizes)} files, {sum(sizes) / 1e6:.0f} MB{can}"
    )


def arm_checks() -> list[Check]:
    """A horizontal arm on one spring: its sag, and the derivative of it."""
    import equinox as eqx
    import jax
    import jax.numpy as jnp
    import numpy as np

    from ..robot import RevoluteJoint, RigidBody, Tool, build, gravity_sag

    length, mass, stiffness = 1.2, 80.0, 2.0e5

    joint = RevoluteJoint("joint", (0.0, 1.0, 0.0), stiffness=stiffness)
    body = RigidBody(mass, (length, 0.0, 0.0), np.zeros((3, 3)))
    arm = build([joint, body, Tool(position=(length, 0.0, 0.0))])

    @jax.jit
    def sag(stiffness: jax.Array | float) -> jax.Array:
        springs = jnp.reshape(jnp.asarray(stiffness), (1,))
        softer = eqx.tree_at(lambda robot: robot.joint_stiffness, arm, springs)
        return gravity_sag(softer, jnp.zeros(1))[2]

    moment, angle = mass * 9.81 * length, 0.0
    for _ in range(50):
        angle = moment * math.cos(angle) / stiffness
    turned = -angle / (stiffness + moment * math.sin(angle))
    expected, slope = -length * math.sin(angle), -length * math.cos(angle) * turned
    step = 1e-4 * stiffness
    difference = float(sag(stiffness + step) - sag(stiffness - step)) / (2 * step)
    derivative = float(jax.grad(sag)(stiffness))
    return [
        Check("sag of an arm [m]", float(sag(stiffness)), expected, 1e-9),
        Check("its derivative [m rad/(N m)]", derivative, slope, 1e-9),
        Check("the same by a difference [m rad/(N m)]", difference, derivative, 1e-6),
    ]


def slot_checks() -> list[Check]:
    """A slot through a block: the mean force of a turn."""
    import numpy as np

    from ..cutter import flat_end_mill
    from ..cutting import LinearEdgeLaw
    from ..sim import simulate_process
    from ..workpiece import box

    # symbols: a depth, c feed per tooth, K coefficients, two teeth
    a, c, count = 1e-3, 0.05e-3, 60
    K_tc, K_rc, K_ac, K_te, K_re, K_ae = 990e6, 337e6, 67e6, 3e3, 15e3, 4.5e3
    law = LinearEdgeLaw(
        K_tc=K_tc, K_rc=K_rc, K_ac=K_ac, K_te=K_te, K_re=K_re, K_ae=K_ae
    )
    x = 3e-3 + c * np.arange(count)
    tips = np.column_stack([x, np.full(count, 4e-3), np.full(count, -a)])
    process = simulate_process(
        tips,
        box([0.0, 0.0, -2e-3], [10e-3, 8e-3, 0.0], 0.25e-3),
        flat_end_mill(diameter=6e-3, teeth=2),
        law,
        8000 * 2 * math.pi / 60,
        axial_depth=1.5e-3,
    )
    mean_force = np.asarray(process.force)[count // 2 :].mean(axis=0)
    expected = (
        -2 * a * (K_rc * c / 4 + K_re / math.pi),
        2 * a * (K_tc * c / 4 + K_te / math.pi),
        2 * a * (K_ac * c / math.pi + K_ae / 2),
    )
    return [
        Check(f"force of a slot along {axis} [N]", float(force), value, 0.02)
        for axis, force, value in zip("xyz", mean_force, expected, strict=True)
    ]
