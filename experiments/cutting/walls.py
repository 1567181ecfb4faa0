"""Where a shaking tool leaves the wall, against the frequency-domain solution."""

import jax
import numpy as np
from references import wall_cut

from reporting import Report

jax.config.update("jax_enable_x64", True)


def measure(report: Report) -> None:
    """Compare both feeds, up and down, over the speed, and along a helix."""
    report.say("wall beyond the ideal one, and tip when it is made, against theory")
    for is_up in (True, False):
        for speed in wall_cut.SPEEDS + wall_cut.NEAR_ZERO:
            for feed in wall_cut.ALONG:
                made = wall_cut.wall(wall_cut.Cut(feed, is_up, speed))
                found, wanted = made.error.mean(), made.expected.mean()
                name = f"{'up' if is_up else 'down'}, {speed:g} rpm, feed {feed}"
                report.say(
                    f"  {name}: wall {1e6 * found:.2f} um, tip "
                    f"{1e6 * made.deviation:.2f}, theory {1e6 * wanted:.2f}, of a "
                    f"vibration of {1e6 * made.peak:.2f}"
                )
                is_small = speed in wall_cut.NEAR_ZERO
                whole = made.peak if is_small else abs(wanted)
                of = " of the vibration" if is_small else ""
                off = 100 * abs(found - wanted) / whole
                report.figure(f"{name}: wall off{of}", off, 5.0)
    for cut in wall_cut.HELICES:
        made = wall_cut.wall(cut)
        name = f"helix, {'up' if cut.is_up else 'down'}, feed {cut.feed}"
        report.say(f"  {name}: wall over theory [um], from tip to top")
        for row in (made.error, made.expected):
            report.say("   " + "".join(f"{1e6 * x:7.2f}" for x in row[::5]))
        off = 100 * np.abs(made.error - made.expected).max() / made.peak
        report.figure(f"{name}: wall off of the vibration", off, 5.0)
