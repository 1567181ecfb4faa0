"""Modes from vibrations and the joints' damping from modes, with their figures."""

import itertools
import pathlib
from typing import TYPE_CHECKING, Any

import numpy as np

from .._session.errors import BadInput
from .._session.progress import Progress
from .outcome import Outcome
from .text import kept_remark, noted

if TYPE_CHECKING:
    from ...config import FrequencyResponse, ModeTask, RingDown
    from ...identification import JointDampingFit

_UNITS = {
    "receptance": "displacement over force [m/N]",
    "mobility": "velocity over force [m/(N s)]",
    "accelerance": "acceleration over force [1/kg]",
}
# A measured frequency this far from the model's belongs to it hardly.
_FAR = 0.3


def identify_modes(task: "ModeTask", progress: Progress) -> Outcome:
    """Fit modes to ring-downs or frequency responses, and the joints' dampers.

    Args:
        task: The measurements.
        progress: Told what is being done.
    """
    from ...config import RingDown, joints_toml, uncertainty_toml

    is_ring = isinstance(task.measured[0], RingDown)
    fits = []
    for one in task.measured:
        progress.update(f"modes of {one.name}")
        try:
            fits.append(_mode_fit(one))
        except ValueError as error:
            raise BadInput(f"{one.name}: {error}") from error
    lines: list[str] = []
    for one, fit in zip(task.measured, fits, strict=True):
        lines += _mode_lines(one, fit, is_ring)
    damping, more = _dampers(task, fits)
    lines += more
    toml = ["# Modes only: give [robot] and joint_positions for the joints' dampers."]
    if damping is not None and damping.identifiable.any():
        assert task.robot is not None
        parts = (damping.damping, damping.standard_errors, damping.identifiable)
        toml = joints_toml(task.robot, "joint_damping", *parts)
        known = damping.identifiable
        share = float(np.max(damping.standard_errors[known] / damping.damping[known]))
        remark = kept_remark(task.robot.joint_names, known)
        toml += uncertainty_toml("damping", share, remark)
    elif damping is not None:
        toml = ["# No joint's damper is identifiable; see summary.txt."]
    facts: dict[str, Any] = {
        "kind": "ring_down" if is_ring else "frequency_response",
        "measured": [
            {"name": one.name, **_mode_facts(fit)}
            for one, fit in zip(task.measured, fits, strict=True)
        ],
    }
    if damping is not None and task.robot is not None:
        facts["joints"] = list(task.robot.joint_names)
        facts["damping_SI"] = damping.damping
        facts["damping_errors_SI"] = damping.standard_errors
        facts["identifiable"] = damping.identifiable
    return Outcome(
        lines, toml, facts, lambda folder: _draw_modes(folder, task, fits, damping)
    )


def _mode_fit(one: "RingDown | FrequencyResponse") -> Any:
    """Return the modes of one measurement."""
    from ...config import RingDown
    from ...identification import (
        fit_frequency_response,
        fit_ring_down,
        ring_down_frequencies,
    )

    if isinstance(one, RingDown):
        guess = one.frequencies
        if guess is None:
            guess = ring_down_frequencies(one.time, one.signal, one.mode_count)
        return fit_ring_down(one.time, one.signal, guess)
    band = one.is_fitted
    return fit_frequency_response(
        one.frequency[band],
        one.response[band],
        modes=one.mode_count if one.frequencies is None else None,
        frequencies=one.frequencies,
        quantity=one.quantity,  # pyright: ignore[reportArgumentType]
    )


def _mode_facts(fit: Any) -> dict[str, Any]:
    facts = {
        "frequencies_Hz": fit.frequencies,
        "frequency_errors_Hz": fit.frequency_errors,
        "damping_ratios": fit.damping_ratios,
        "damping_errors": fit.damping_errors,
        "identifiable": fit.identifiable,
        "is_structural": fit.is_structural,
        "explained": fit.explained,
    }
    if hasattr(fit, "stiffness"):
        facts["modal_stiffness_N_per_m"] = fit.stiffness
        facts["modal_stiffness_errors_N_per_m"] = fit.stiffness_errors
    return facts


def _mode_lines(one: Any, fit: Any, is_ring: bool) -> list[str]:
    """Return the modes of one measurement."""
    lines = [f"{one.name}: the modes explain {fit.explained:.2%} of the signal"]
    for note in one.notes:
        lines += noted(note)
    head = f"  {'frequency':>12}{'std. error':>12}{'damping':>10}{'std. error':>12}"
    lines.append(head + ("" if is_ring else f"{'modal stiffness':>18}"))
    for k in range(len(fit.frequencies)):
        row = (
            f"  {fit.frequencies[k]:9.4g} Hz{fit.frequency_errors[k]:9.2g} Hz"
            f"{100 * fit.damping_ratios[k]:8.3g} %{100 * fit.damping_errors[k]:10.2g} %"
        )
        if not is_ring:
            row += (
                f"{fit.stiffness[k] * 1e-6:9.4g} +- "
                f"{fit.stiffness_errors[k] * 1e-6:.2g} N/um"
            )
        if not fit.is_structural[k]:
            row += "   no mode: no structure is damped so much"
        elif not fit.identifiable[k]:
            row += "   not identifiable"
        lines.append(row)
    if fit.explained < 0.9:
        lines += noted(
            "That is little: more modes, another band, or a later start may be needed.",
            "warning",
        )
    return lines


def _dampers(
    task: "ModeTask", fits: list[Any]
) -> "tuple[JointDampingFit | None, list[str]]":
    """Return the joints' dampers, and what to say of them."""
    from ...identification import fit_joint_damping
    from ...robot import natural_frequencies

    posed = [
        (one, fit)
        for one, fit in zip(task.measured, fits, strict=True)
        if one.q is not None
    ]
    if task.robot is None or not posed:
        return None, []
    robot, lines, ratios = task.robot, [], []
    for one, fit in posed:
        assert one.q is not None
        own = np.asarray(natural_frequencies(robot, one.q), np.float64)
        row = np.full(robot.joint_count, np.nan)
        own_modes = zip(fit.frequencies, fit.damping_ratios, strict=True)
        for f, zeta in itertools.compress(own_modes, fit.identifiable):
            k = int(np.argmin(np.abs(np.log(own / f))))
            away = f / own[k] - 1
            lines.append(
                f"  {one.name}: {f:.4g} Hz is taken for mode {k + 1} of the model, "
                f"{own[k]:.4g} Hz ({away:+.0%})"
            )
            if abs(away) > _FAR:
                lines += noted(
                    "That is far: the mode is left out; correct the stiffness first.",
                    "warning",
                )
            elif np.isfinite(row[k]):
                lines += noted(
                    f"Mode {k + 1} is taken already: the second was left out.",
                    "warning",
                )
            else:
                row[k] = zeta
        ratios.append(row)
    if not np.isfinite(np.array(ratios)).any():
        return None, [*lines, "no measured mode belongs to the model"]
    fit = fit_joint_damping(robot, [one.q for one, _ in posed], ratios)
    lines += ["", "joint dampers [N m s/rad, N s/m]:"]
    for i, name in enumerate(robot.joint_names):
        text = "not identifiable"
        if fit.identifiable[i]:
            text = f"{fit.damping[i]:.4g} +- {fit.standard_errors[i]:.2g}"
        lines.append(f"  {name}: {text}")
    for pose, mode in fit.outliers:
        lines += noted(
            f"Mode {mode + 1} of {posed[pose][0].name} contradicts the others and was "
            "left out.",
            "warning",
        )
    if not fit.identifiable.all():
        lines += noted(
            "Ring-downs in further poses, and of higher modes, show further joints."
        )
    return fit, lines


def _draw_modes(
    folder: pathlib.Path,
    task: "ModeTask",
    fits: list[Any],
    damping: "JointDampingFit | None",
) -> None:
    """Write the figures."""
    from ...config import RingDown
    from ...viz import (
        plot_correlation,
        plot_frequency_response,
        plot_joint_values,
        plot_ring_down,
        save_figure,
    )

    for i, (one, fit) in enumerate(zip(task.measured, fits, strict=True), 1):
        number = f"_{i}" if len(fits) > 1 else ""
        modes = range(1, len(fit.frequencies) + 1)
        names = [f"{what} {k}" for what in ("f", "zeta") for k in modes]
        figure = plot_correlation(names, fit.correlation)
        save_figure(figure, folder / f"correlation{number}.png")
        if isinstance(one, RingDown):
            figure = plot_ring_down(one.time, one.signal, fit.fitted, title=one.name)
            save_figure(figure, folder / f"ring_down{number}.png")
            continue
        figure = plot_frequency_response(
            one.frequency,
            one.response,
            one.frequency[one.is_fitted],
            fit.fitted,
            unit=_UNITS[one.quantity],
            modes=fit.frequencies,
            title=one.name,
        )
        save_figure(figure, folder / f"frequency_response{number}.png")
    if damping is not None and task.robot is not None:
        figure = plot_joint_values(
            task.robot.joint_names,
            damping.damping,
            damping.standard_errors,
            np.asarray(task.robot.joint_damping, np.float64),
            unit="damping [N m s/rad, N s/m]",
        )
        save_figure(figure, folder / "damping.png")
        figure = plot_correlation(task.robot.joint_names, damping.correlation)
        save_figure(figure, folder / "damping_correlation.png")
