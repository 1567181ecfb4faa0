"""A campaign of small jobs: two workers against one, and a worker that is killed.

python experiments/campaign/run.py [--draws 20] [--example paper_small] [--out FOLDER]

Ten spindle speeds and so many draws of a coefficient. Of an example as short as `tiny`,
200 jobs run hardly longer than two workers need to start.
"""

import argparse
import pathlib
import sys
import tempfile
import time

HERE = pathlib.Path(__file__).parent
LEAST_GAIN = 1.8
SWEEP = """
job = "{example}.toml"
draws = {draws}
seed = 1
[[sweep]]
key = "spindle.speed"
values = ["8000 rpm", "7900 rpm", "7800 rpm", "7700 rpm", "7600 rpm",
          "7500 rpm", "7400 rpm", "7300 rpm", "7200 rpm", "7100 rpm"]
[[draw]]
key = "force.K_tc"
kind = "lognormal"
relative = 0.1
"""


def measure(report, draws, example):
    """Run the campaign with one worker and with two, then with one of two killed."""
    from diffmill import config
    from diffmill.campaign import run_campaign
    from diffmill.examples import copy_example

    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        copy_example(example, folder)
        (folder / "sweep.toml").write_text(SWEEP.format(draws=draws, example=example))
        plan = config.load_campaign(folder / "sweep.toml")
        count = 10 * draws
        # What is compiled is on the disk then, for all of them.
        (folder / "warm.toml").write_text(SWEEP.format(draws=1, example=example))
        run_campaign(config.load_campaign(folder / "warm.toml"), folder / "warm")
        spent = {}
        for workers in (1, 2):
            begin = time.perf_counter()
            data = run_campaign(plan, folder / f"workers{workers}", workers=workers)
            spent[workers] = time.perf_counter() - begin
            report.say(f"{count} jobs, {workers} workers: {spent[workers]:.0f} s")
            report.require("all done", bool((data.status == 0).all()))
        report.at_least("two workers over one", spent[1] / spent[2], LEAST_GAIN, "x")
        killed, told = [], []

        def tell(done, total, status):
            del status
            told.append(done)
            if done == total // 2:
                killed.append(kill_a_worker())

        data = run_campaign(plan, folder / "killed", workers=2, on_progress=tell)
        report.say(f"kill -9 of a worker after {count // 2} jobs:")
        report.require("a worker was killed", killed == [True])
        report.require("all done", bool((data.status == 0).all()))
        files = list((folder / "killed" / "jobs").glob("*.json"))
        report.require("a result for each job", len(files) == count)
        report.require("each done once", told == list(range(count + 1)))


def kill_a_worker():
    """Kill one worker process with SIGKILL; return whether there was one."""
    import psutil

    children = psutil.Process().children(recursive=True)
    found = [p for p in children if "spawn_main" in " ".join(p.cmdline())]
    if found:
        found[0].kill()
    return bool(found)


if __name__ == "__main__":
    sys.path.append(str(HERE.parent / "common"))
    from reporting import Report, store

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--example", default="paper_small")
    parser.add_argument("--out", type=pathlib.Path, default=HERE / "results")
    given = parser.parse_args()
    result = Report("diffmill campaign")
    measure(result, given.draws, given.example)
    store(result, given.out, "campaign")
