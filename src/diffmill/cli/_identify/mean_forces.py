"""Coefficients from mean forces over the feed, with their figures."""

import pathlib
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .._session.progress import Progress
from .diagnoses import diagnosis_lines
from .outcome import Outcome
from .registration import placed, samples
from .text import NONSENSE, axes_text, coefficient_lines, correlation_lines, noted

if TYPE_CHECKING:
    from ...config import MeanForceTask
    from ...identification import MeanAxes, MeanForceFit, RecordRegistration


class Amplitude(NamedTuple):
    """The tooth-passing frequency in one record, which the means do not show.

    Attributes:
        measured: Amplitude per force of the work [N], shape (3,).
        predicted: By the coefficients, shape (3,).
    """

    measured: Any
    predicted: Any


def identify_means(task: "MeanForceTask", progress: Progress) -> Outcome:
    """Fit the coefficients to mean forces.

    Args:
        task: The means and settings.
        progress: Told what is being done.
    """
    from ...identification import immersion, propose_mean_axes

    cut = task.cut
    entry, leave = immersion(
        2 * float(cut.cutter.nominal_radius),
        cut.radial_depth,
        cut.side,  # pyright: ignore[reportArgumentType]
    )
    shape = {
        "teeth": cut.cutter.flute_count,
        "axial_depth": cut.axial_depth,
        "entry_angle": entry,
        "exit_angle": leave,
    }
    progress.update("lines over the feed")
    found = propose_mean_axes(task.feed_per_tooth, task.mean_force, **shape)
    axes = task.fit.axes or ("x", "y", "z")
    if task.fit.takes_proposed:
        axes = found[0].axes
    used = next(one for one in found if one.axes == axes)
    force = _turned(task.mean_force, axes)
    left = _left_out(task.feed_per_tooth, force, shape)
    amplitudes, told = [], []
    for record in task.records:
        progress.update(f"tooth passing of {record.name}")
        beside = placed(record, task.fit.refines_speed, task.records)
        amplitudes.append(_amplitude(record, beside, used.fit, axes))
        told += diagnosis_lines(beside.diagnoses)
    lines = [
        *_input_lines(task),
        *told,
        *_axes_lines(used, found, task.fit.takes_proposed),
        *_fit_lines(used.fit, force, left),
        *_amplitude_lines(task, amplitudes),
    ]
    toml, share = _toml(task, used, shape, found[0].score >= used.score)
    facts = {
        "kind": "mean_forces",
        "feed_per_tooth_m": task.feed_per_tooth,
        "mean_force_N": force,
        "axes": axes,
        "proposed_axes": found[0].axes,
        "coefficients_SI": used.fit.coefficients,
        "standard_errors_SI": used.fit.standard_errors,
        "correlation": used.fit.correlation,
        "identifiable": used.fit.identifiable,
        "r_squared": used.fit.r_squared,
        "relative_uncertainty": share,
        "left_out_N": left,
        "amplitudes_N": [
            {"measured": a.measured, "predicted": a.predicted} for a in amplitudes
        ],
        "notes": task.notes,
    }
    return Outcome(
        lines, toml, facts, lambda folder: _draw(folder, task, used.fit, force, left)
    )


def _turned(force: Any, axes: tuple[str, str, str]) -> Any:
    """Return recorded forces in the axes of the feed."""
    signs = np.array([-1.0 if name.startswith("-") else 1.0 for name in axes])
    return force[:, ["xyz".index(name[-1]) for name in axes]] * signs[None]


def _left_out(feeds: Any, force: Any, shape: dict[str, Any]) -> Any:
    """Return every mean as the other feeds predict it; NaN where they cannot."""
    from ...identification import fit_mean_forces

    out = np.full_like(force, np.nan)
    for i in range(len(feeds)):
        rest = feeds != feeds[i]
        if np.unique(feeds[rest]).size >= 2:
            fit = fit_mean_forces(feeds[rest], force[rest], **shape)
            out[i] = fit.slope * feeds[i] + fit.offset
    return out


def _amplitude(
    record: Any,
    beside: "RecordRegistration",
    fit: "MeanForceFit",
    axes: tuple[str, str, str],
) -> Amplitude:
    """Return the amplitude at the tooth passing, measured and predicted."""
    from ...identification import engagement_columns

    time, force = samples(record)
    tooth = beside.cut.tooth_period
    count = np.floor((time[-1] - time[0]) / tooth + 1e-6)
    keep = (time < time[0] + count * tooth) & np.isfinite(force).all(axis=1)

    def at_tooth(when: Any, values: Any) -> Any:
        wave = np.exp(-2j * np.pi / tooth * when)
        return 2 * np.abs(np.mean(values * wave[:, None], axis=0))

    measured = at_tooth(time[keep], _turned(force[keep], axes))
    found = engagement_columns(beside.cut)
    K = np.array(list(fit.coefficients.values()))
    wave = found.columns @ K + found.constant
    samples_per_tooth = round(tooth / found.spacing)
    # The last whole revolutions: the cut begins within the stock.
    turn = samples_per_tooth * beside.cut.cutter.flute_count
    last = wave[-4 * turn :]
    return Amplitude(measured, at_tooth(found.spacing * np.arange(len(last)), last))


def _input_lines(task: "MeanForceTask") -> list[str]:
    """Return what the means are of."""
    cut = task.cut
    width = "slot"
    low, high = 1e3 * task.feed_per_tooth.min(), 1e3 * task.feed_per_tooth.max()
    if cut.radial_depth is not None:
        width = f"{cut.side} milling, {cut.radial_depth * 1e3:g} mm wide"
    lines = [
        f"mean forces at {len(task.feed_per_tooth)} feeds, {low:g} to {high:g} mm "
        f"per tooth; {cut.cutter.flute_count} teeth, {cut.axial_depth * 1e3:g} mm "
        f"deep, {width}"
    ]
    for note in task.notes:
        lines += noted(note)
    for record in task.records:
        for note in record.notes:
            lines += noted(f"{record.name}: {note}")
        if record.is_saturated:
            lines += noted(
                f"{record.name}: samples are saturated, so that its mean force is too "
                "small; leave the record out or fit whole records.",
                "warning",
            )
    return lines


def _axes_lines(
    used: "MeanAxes", found: "tuple[MeanAxes, ...]", takes_proposed: bool
) -> list[str]:
    """Return what the means say of the axes; nothing is changed by it."""
    why = "the likeliest, as asked for" if takes_proposed else "as given or recorded"
    lines = [f"axes: {axes_text(used.axes)} ({why})"]
    lines += [f"  against them: {violation}" for violation in used.violations]
    best = found[0]
    if best.score < used.score:
        against = "; ".join(best.violations) or "nothing"
        lines += noted(
            f"The axes {axes_text(best.axes)} make more sense (against them: {against};"
            f" K_tc {best.fit.coefficients['K_tc'] * 1e-6:.4g}, K_rc "
            f"{best.fit.coefficients['K_rc'] * 1e-6:.4g}, K_ac "
            f"{best.fit.coefficients['K_ac'] * 1e-6:.4g} N/mm^2). Nothing was changed; "
            'give `axes` in [fit], or "proposed".',
            "warning",
        )
    alike = [one for one in found if one.score <= best.score and one is not best]
    if alike:
        names = ", ".join(axes_text(one.axes) for one in alike[:4])
        lines += noted(
            f"From mean forces alone {names} would make as much sense; whole records "
            "tell more."
        )
    return lines


def _fit_lines(fit: "MeanForceFit", force: Any, left: Any) -> list[str]:
    """Return coefficients and how far to trust them."""
    lines = [
        "",
        *coefficient_lines(
            fit.coefficients, fit.coefficients, fit.standard_errors, fit.identifiable
        ),
        "the lines explain "
        + ", ".join(
            f"{share:.2%} of F{axis}"
            for axis, share in zip("xyz", fit.r_squared, strict=True)
        )
        + " over the feed",
    ]
    if len(force) == 2:
        lines += noted(
            "Two feeds make a line but no standard error: add a third, better five."
        )
    lost = [name for name, known in fit.identifiable.items() if not known]
    if lost and len(force) > 2:
        lines += noted(
            f"{', '.join(lost)}: the standard error is large beside the mean forces; a "
            "wider range of feeds tells cutting and edge coefficients better apart, "
            "deeper cuts lift both over the noise."
        )
    good = np.isfinite(left).all(axis=1)
    if good.any():
        off = np.sqrt(np.mean((left - force)[good] ** 2, axis=0))
        size = np.sqrt(np.mean(force[good] ** 2, axis=0))
        parts = [
            f"F{a} {o / s:.1%}" if s > 0 else f"F{a} -"
            for a, o, s in zip("xyz", off, size, strict=True)
        ]
        lines.append(
            "left out: each feed predicted by the others, off by " + ", ".join(parts)
        )
    return lines + correlation_lines(list(fit.coefficients), fit.correlation)


def _amplitude_lines(task: "MeanForceTask", amplitudes: list[Amplitude]) -> list[str]:
    """Return the amplitudes that the means do not show."""
    if not amplitudes:
        return []
    lines = ["amplitude at the tooth passing, not fitted [N]: predicted / measured"]
    for record, one in zip(task.records, amplitudes, strict=True):
        parts = [
            f"F{a} {p:.4g} / {m:.4g}"
            for a, p, m in zip("xyz", one.predicted, one.measured, strict=True)
        ]
        lines.append(f"  {record.name}: {', '.join(parts)}")
    return lines


def _toml(
    task: "MeanForceTask", used: "MeanAxes", shape: dict[str, Any], is_likely: bool
) -> tuple[list[str], float]:
    """Return the tables for a job, comments if in doubt, and the uncertainty."""
    from ...config import doubted, force_toml, uncertainty_toml
    from ...identification import mean_force_matrices, relative_uncertainty

    fit = used.fit
    slope, offset = mean_force_matrices(*shape.values())
    rows = np.concatenate(
        [np.hstack([feed * slope, offset]) for feed in task.feed_per_tooth]
    )
    share = relative_uncertainty(
        fit.coefficients, fit.standard_errors, fit.correlation, rows
    )
    lines = [
        *force_toml(fit.coefficients, fit.standard_errors, fit.identifiable),
        *uncertainty_toml("force", share),
    ]
    if fit.coefficients["K_tc"] <= 0:
        lines = doubted(lines, NONSENSE)
    elif not is_likely:
        lines = doubted(lines, "Other axes make more sense; see summary.txt.")
    elif not any(fit.identifiable.values()):
        lines = doubted(lines, "No coefficient is identifiable; see summary.txt.")
    return lines, share


def _draw(
    folder: pathlib.Path,
    task: "MeanForceTask",
    fit: "MeanForceFit",
    force: Any,
    left: Any,
) -> None:
    """Write the figures."""
    from ...viz import plot_correlation, plot_mean_forces, save_figure

    figure = plot_mean_forces(
        task.feed_per_tooth, force, fit.slope, fit.offset, left_out=left
    )
    save_figure(figure, folder / "mean_forces.png")
    figure = plot_correlation(list(fit.coefficients), fit.correlation)
    save_figure(figure, folder / "correlation.png")
