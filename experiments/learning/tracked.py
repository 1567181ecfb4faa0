"""Parts that a tracker follows, on machines with reversal, links, springs, forces."""

from loop import drawn, judge, load, table, tracked


def measure(report):
    """Print the table."""
    job = load()
    found = table(report, job, drawn(job), tracked)
    judge(report, found, [(5.0, 7.0), (4.0, 5.0), (3.5, 4.5)])
