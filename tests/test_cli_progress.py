"""The display of progress in a log."""

import time

from diffmill.cli._session.progress import Progress


def test_a_long_step_tells_its_share_and_the_time_left(monkeypatch, capsys):
    now = [0.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    progress = Progress()
    progress.update("uncorrected")
    for second in range(1, 21):
        now[0] = float(second)
        progress.within("step 1 over 900 tooth periods", second / 40)
    lines = capsys.readouterr().err.splitlines()
    # A line where it was silent for eight seconds, not for each part.
    assert lines == [
        "   0.0 s  uncorrected",
        "   9.0 s   22 %  step 1 over 900 tooth periods, about 31 s left",
        "  18.0 s   45 %  step 1 over 900 tooth periods, about 22 s left",
    ]
    # Another step begins anew.
    now[0] = 40.0
    progress.within("step 2 over 900 tooth periods", 0.5)
    assert "50 %  step 2 over 900 tooth periods\n" in capsys.readouterr().err


def test_a_quiet_run_tells_nothing(capsys):
    Progress(is_quiet=True).within("step 1", 0.5)
    assert capsys.readouterr().err == ""
