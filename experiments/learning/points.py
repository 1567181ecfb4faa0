"""Parts of which a probe touches points of the walls."""

from loop import drawn, judge, load, probed, table


def measure(report):
    """Print the table."""
    job = load()
    radius = float(job.cutter.nominal_radius)
    see = lambda run, stream: probed(run, stream, radius)
    found = table(report, job, drawn(job), see, rounds=2)
    judge(report, found, [(7.0, 7.5), (6.0, 6.5)])
