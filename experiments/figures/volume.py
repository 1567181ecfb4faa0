"""Removed volume: nothing is lost, and a slot has its exact volume."""

import math

import numpy as np

from shared import (
    DIAMETER,
    LAW,
    RADIUS,
    Report,
    compiled_process,
    random_block,
)

STEPS = 140


def measure(report: Report) -> None:
    """Measure the balance and the volume of slots at ten offsets and depths."""
    rng = np.random.default_rng(11)
    report.say()
    report.say("Estimator: the mean of the families with the weights of the stock;")
    report.say(
        "those of a box are (x, y, z) = (0, 0, 1): the rays along the tool alone."
    )
    report.say()
    report.say("Slots that enter from outside, ten random offsets and depths [%]")
    report.say(
        f"  {'depth [mm]':>12}{'balance':>12}{'estimate':>10}{'x':>9}{'y':>9}{'z':>9}"
    )
    balances, estimates = [], []
    for index in range(10):
        balance, estimate, families, depth = _slot(rng, starts_inside=index % 2 == 1)
        balances.append(balance)
        estimates.append(abs(estimate))
        each = "".join(f"{value:9.3f}" for value in families)
        report.say(f"  {1e3 * depth:12.4f}{balance:12.1e}{estimate:10.3f}{each}")
    report.figure("sum over steps against before - after", max(balances), 1e-9, "")
    report.figure("estimate of the slot's volume, largest error", max(estimates), 0.5)


def _slot(
    rng: np.random.Generator, *, starts_inside: bool
) -> tuple[float, float, np.ndarray, float]:
    """Return balance, and errors of the estimate and of each family in %."""
    lower, upper, stock = random_block(rng)
    depth = rng.uniform(0.3e-3, 1.25e-3)
    y = (lower[1] + upper[1]) / 2 + rng.uniform(-1e-3, 1e-3)
    start = lower[0] + (RADIUS + 1e-3 if starts_inside else -RADIUS - 0.3e-3)
    x = start + rng.uniform(0, 0.2e-3) + 0.1875e-3 * np.arange(STEPS)
    path = np.column_stack([x, np.full(STEPS, y), np.full(STEPS, -depth)])
    solution = compiled_process()(path, stock, LAW)
    removed = float(stock.volume() - solution.stock.volume())
    summed = float(np.sum(solution.removed_volume) + solution.initial_overlap_volume)
    # A straight part and half a circle, at both ends if the tool starts inside.
    length = x[-1] - (x[0] if starts_inside else lower[0])
    area = length * DIAMETER + (1 + starts_inside) * math.pi * RADIUS**2 / 2
    exact = area * depth
    families = np.asarray(stock.volumes() - solution.stock.volumes())
    return (
        abs(summed - removed) / removed,
        100 * (removed / exact - 1),
        100 * (families / exact - 1),
        depth,
    )
