"""The commands, their arguments, and the exit code."""

import _thread
import dataclasses
import os
import pathlib
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from importlib import metadata
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import tyro

from .._messages import printable
from .._toml import read_toml
from ._session.errors import BadInput, Interrupted, bad_input
from ._session.feed_request import FeedRequest
from ._session.job_options import JobOptions, ProgramKeys, ToolAxisOption
from ._session.usage import check_usage, shell_of

if TYPE_CHECKING:
    from ._session.progress import Progress

_JobFile = Annotated[
    tyro.conf.Positional[pathlib.Path],
    tyro.conf.arg(metavar="JOB.toml", help="The job file."),
]
_Out = Annotated[
    pathlib.Path | None,
    tyro.conf.arg(help="Folder for the results; ./<job>-<command> if not given."),
]
_Force = Annotated[bool, tyro.conf.arg(help="Replace what is there already.")]
_Quiet = Annotated[bool, tyro.conf.arg(help="Print nothing but errors.")]


@dataclasses.dataclass(frozen=True)
class _Display:
    """Options of a command that shows its progress.

    Attributes:
        quiet: True to print nothing but errors.
        verbose: True to keep every line of progress.
    """

    quiet: _Quiet = False
    verbose: Annotated[
        bool, tyro.conf.arg(help="Keep every line of progress; name what is compiled.")
    ] = False

    def progress(self, *, prints_json: bool = False) -> "Progress":
        """Display of the progress."""
        from ._session.progress import Progress

        if self.quiet and self.verbose:
            raise BadInput("--quiet and --verbose exclude each other")
        return Progress(
            is_quiet=self.quiet, is_verbose=self.verbose, prints_json=prints_json
        )


# Without a name of its own: the options are --quiet and --verbose.
_Shown = Annotated[_Display, tyro.conf.arg(name="")]
_Band = Annotated[
    str | None,
    tyro.conf.arg(
        metavar="LENGTH",
        help='Contour error to compare the result with, such as "20 um", in place of '
        "that of the job.",
    ),
]
_Json = Annotated[
    bool, tyro.conf.arg(help="Print the figures of all cases as JSON, in SI units.")
]
_Resume = Annotated[
    bool,
    tyro.conf.arg(
        help="Go on from where an interrupted run of the same job was: from the "
        "checkpoint beside --out."
    ),
]
_Outside = Annotated[
    bool, tyro.conf.arg(help="Let the job name files outside its own folder.")
]


def _read(file: pathlib.Path) -> None:
    """Refuse a file that is no TOML before imports that take seconds."""
    with bad_input():
        read_toml(file)


def _check_tables(job: pathlib.Path) -> None:
    """Refuse a job whose tables have faults before imports that take seconds."""
    from ..config import check_tables

    with bad_input():
        check_tables(job)


def simulate(
    job: _JobFile,
    *,
    out: _Out = None,
    force: _Force = False,
    shown: _Shown = _Display(),
    json: _Json = False,
    allow_outside: _Outside = False,
    tolerance_band: _Band = None,
    resume: _Resume = False,
) -> int:
    """Predict forces, deviation and the machined surface of a job."""
    _check_tables(job)
    from ._run_job import run_job

    return run_job(
        "simulate",
        job,
        out,
        force=force,
        progress=shown.progress(prints_json=json),
        allow_outside=allow_outside,
        tolerance_band=tolerance_band,
        resume=resume,
    )


def correct(
    job: _JobFile,
    *,
    out: _Out = None,
    force: _Force = False,
    shown: _Shown = _Display(),
    json: _Json = False,
    allow_outside: _Outside = False,
    tolerance_band: _Band = None,
    resume: _Resume = False,
) -> int:
    """Predict, correct the path, predict again; write the corrected program."""
    _check_tables(job)
    from ._run_job import run_job

    return run_job(
        "correct",
        job,
        out,
        force=force,
        progress=shown.progress(prints_json=json),
        allow_outside=allow_outside,
        tolerance_band=tolerance_band,
        resume=resume,
    )


def feed(
    job: _JobFile,
    *,
    request: Annotated[FeedRequest, tyro.conf.arg(name="")] = FeedRequest(),
    out: _Out = None,
    force: _Force = False,
    shown: _Shown = _Display(),
    allow_outside: _Outside = False,
) -> int:
    """Say what a slower or faster feed costs in error; tune the feed along the path."""
    _check_tables(job)
    from ._feed import run_feed

    return run_feed(
        job,
        request,
        out,
        force=force,
        progress=shown.progress(),
        allow_outside=allow_outside,
    )


def stability(
    job: _JobFile,
    *,
    speeds: Annotated[
        tuple[float, ...],
        tyro.conf.arg(
            help="Lowest and highest spindle speed [rpm]; 0.6 and 1.5 times the "
            "program's if not given."
        ),
    ] = (),
    out: _Out = None,
    force: _Force = False,
    shown: _Shown = _Display(),
    allow_outside: _Outside = False,
) -> int:
    """Say which depth of cut each spindle speed allows without chatter."""
    _check_tables(job)
    from ._stability import run_stability

    return run_stability(
        job,
        speeds,
        out,
        force=force,
        progress=shown.progress(),
        allow_outside=allow_outside,
    )


def campaign(
    file: Annotated[
        tyro.conf.Positional[pathlib.Path],
        tyro.conf.arg(metavar="FILE.toml", help="A file that says what varies."),
    ],
    *,
    workers: Annotated[
        int | None,
        tyro.conf.arg(
            help="Worker processes; one per core if not given, 0 for none but this one."
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        tyro.conf.arg(help="Address of a Dask scheduler whose workers to use instead."),
    ] = None,
    retry: Annotated[
        bool, tyro.conf.arg(help="Run jobs that have failed once more.")
    ] = False,
    out: Annotated[
        pathlib.Path | None,
        tyro.conf.arg(help="Folder for the results; ./<file>-campaign if not given."),
    ] = None,
    force: Annotated[
        bool, tyro.conf.arg(help="Run every job anew, also those with a result.")
    ] = False,
    shown: _Shown = _Display(),
    allow_outside: _Outside = False,
) -> int:
    """Run many jobs that differ in a few keys; go on from where it was interrupted."""
    _read(file)
    from ._campaign import Workers, run_campaign_file

    return run_campaign_file(
        file,
        Workers(workers, scheduler, retry),
        out,
        force=force,
        progress=shown.progress(),
        allow_outside=allow_outside,
    )


def identify(
    file: Annotated[
        tyro.conf.Positional[pathlib.Path],
        tyro.conf.arg(
            metavar="FILE.toml",
            help="A file that says what was measured, or a job before FORCES.",
        ),
    ],
    forces: Annotated[
        tyro.conf.Positional[pathlib.Path | None],
        tyro.conf.arg(
            metavar="[FORCES]", help="Measured forces of the job: text, TDMS, MAT, ..."
        ),
    ] = None,
    *,
    out: Annotated[
        pathlib.Path | None,
        tyro.conf.arg(help="Folder for the results; ./<file>-identify if not given."),
    ] = None,
    force: _Force = False,
    shown: _Shown = _Display(),
    allow_outside: _Outside = False,
) -> int:
    """Fit force coefficients, joint stiffness or damping to what was measured."""
    _read(file)
    from ._identify.identify import run_identify

    return run_identify(
        file,
        forces,
        out,
        force=force,
        progress=shown.progress(),
        allow_outside=allow_outside,
    )


def learn(
    file: Annotated[
        tyro.conf.Positional[pathlib.Path],
        tyro.conf.arg(
            metavar="FILE.toml",
            help="A file that names a job, the commands that were cut and what was "
            "measured.",
        ),
    ],
    *,
    advise: Annotated[
        bool,
        tyro.conf.arg(
            help="Rank measurements by what they would leave unknown of the part, "
            "instead of the program of the next one."
        ),
    ] = False,
    out: Annotated[
        pathlib.Path | None,
        tyro.conf.arg(help="Folder for the results; ./<file>-learn if not given."),
    ] = None,
    force: _Force = False,
    shown: _Shown = _Display(),
    allow_outside: _Outside = False,
    resume: Annotated[
        bool,
        tyro.conf.arg(
            help="Go on from where an interrupted run of the same file was: from the "
            "checkpoint beside --out."
        ),
    ] = False,
) -> int:
    """Learn the machine from measured parts; write the program of the next one."""
    _read(file)
    from ._learn import run_learn

    return run_learn(
        file,
        out,
        advises=advise,
        force=force,
        progress=shown.progress(),
        allow_outside=allow_outside,
        resume=resume,
    )


def robot(
    model: Annotated[
        tyro.conf.Positional[str | None],
        tyro.conf.arg(
            metavar="MODEL",
            help="A built-in model, a robot file (.toml, .urdf), or a job, whose robot "
            "carries its tool and is half-way through the path.",
        ),
    ] = None,
    *,
    list: Annotated[
        bool,
        tyro.conf.arg(
            help="List the built-in models, arms with public models, and the classes "
            "of drives."
        ),
    ] = False,
    pose: Annotated[
        str | None,
        tyro.conf.arg(
            help="Joint positions with units, separated by commas; home if not given."
        ),
    ] = None,
    tool: Annotated[
        str | None,
        tyro.conf.arg(help="The tool, in a URDF the link, if there are several."),
    ] = None,
    drives: Annotated[
        pathlib.Path | None,
        tyro.conf.arg(
            help="A TOML file with what the robot's own does not say, such as springs, "
            'or a class of springs, such as "class 200 kg".'
        ),
    ] = None,
    out: Annotated[
        pathlib.Path | None,
        tyro.conf.arg(help="Folder for the results; ./<model>-robot if not given."),
    ] = None,
    force: _Force = False,
    shown: _Shown = _Display(),
    allow_outside: _Outside = False,
) -> int:
    """Print masses, stiffness, modes and sag of a robot; draw it and its stiffness."""
    if list:
        from ._robot.known import known_lines

        print("\n".join(known_lines()))
        return 0
    from ._robot.robot import run_robot

    if model is None:
        raise BadInput("robot: found no MODEL; --list lists those that are known")
    return run_robot(
        model,
        pose=pose,
        tool=tool,
        drives=drives,
        out=out,
        force=force,
        progress=shown.progress(),
        allow_outside=allow_outside,
    )


def example(
    name: Annotated[
        tyro.conf.Positional[str | None],
        tyro.conf.arg(metavar="NAME", help="The example; without, all are listed."),
    ] = None,
    *,
    out: Annotated[
        pathlib.Path,
        tyro.conf.arg(help="Folder for the files; the current one if not given."),
    ] = pathlib.Path("."),
    force: _Force = False,
    quiet: _Quiet = False,
) -> int:
    """Write a ready-to-run example job beside its program."""
    from ..examples import EXAMPLES, copy_example

    if name is None:
        print("\n".join(f"{known:<15}{line}" for known, line in EXAMPLES.items()))
        return 0
    with bad_input():
        job = copy_example(name, out, force=force)
    program = job.with_suffix(".ngc")
    if not quiet and program.exists():
        print(f"wrote {job} and {program}\nnext: diffmill correct {job}")
    elif not quiet:
        print(f"wrote {job}\nnext: diffmill identify {job}")
    return 0


def new(
    program: Annotated[
        tyro.conf.Positional[pathlib.Path],
        tyro.conf.arg(metavar="PROGRAM", help="A program or a recorded path."),
    ],
    *,
    options: Annotated[JobOptions, tyro.conf.arg(name="")] = JobOptions(),
    out: Annotated[
        pathlib.Path | None,
        tyro.conf.arg(help="The job; PROGRAM with .toml if not given."),
    ] = None,
    force: _Force = False,
    shown: _Shown = _Display(),
) -> int:
    """Write a commented job for a program; a terminal prompts for missing values."""
    from ._new import run_new

    can_ask = sys.stdin.isatty() and sys.stdout.isatty()
    return run_new(
        program,
        options,
        out,
        force=force,
        progress=shown.progress(),
        ask=input if can_ask else None,
    )


def doctor(*, quiet: _Quiet = False) -> int:
    """Print versions, devices and the compile cache; test the installation."""
    from ._doctor import run_doctor

    return run_doctor(is_quiet=quiet)


def check(
    file: Annotated[
        tyro.conf.Positional[pathlib.Path],
        tyro.conf.arg(
            metavar="FILE",
            help="A program, a path, a job, a campaign, or a file for `identify`.",
        ),
    ],
    *,
    tool_axis: ToolAxisOption = None,
    program: ProgramKeys = (),
    allow_outside: _Outside = False,
) -> int:
    """Say what a file contains and what of it is not supported."""
    if file.suffix == ".toml":
        _read(file)
    from ._check import describe_file

    with bad_input():
        lines = describe_file(
            file, allow_outside=allow_outside, tool_axis=tool_axis, keys=program
        )
    print(printable("\n".join(lines)), flush=True)
    return 0


def convert(
    source: Annotated[
        tyro.conf.Positional[pathlib.Path],
        tyro.conf.arg(
            metavar="IN", help="A program or path; its suffix is its format."
        ),
    ],
    target: Annotated[
        tyro.conf.Positional[pathlib.Path],
        tyro.conf.arg(
            metavar="OUT", help="The file to write; its suffix is its format."
        ),
    ],
    *,
    tolerance: Annotated[
        str,
        tyro.conf.arg(help="How far what is written may lie beside what is read."),
    ] = "1 um",
    spline: Annotated[
        bool, tyro.conf.arg(help="Whether a path becomes a spline (KRL).")
    ] = False,
    tool_axis: ToolAxisOption = None,
    program: ProgramKeys = (),
    force: _Force = False,
    quiet: _Quiet = False,
) -> int:
    """Write a program in another format: G-code, KRL, RAPID, APT, a path as CSV."""
    from ..units import LENGTH, quantity
    from ._convert import convert_file

    with bad_input():
        length = quantity(tolerance, LENGTH)
        if not length > 0:
            raise ValueError(f"--tolerance: found {tolerance!r}; needed is one above 0")
        lines = convert_file(
            source,
            target,
            tolerance=length,
            force=force,
            is_spline=spline,
            tool_axis=tool_axis,
            keys=program,
        )
    if not quiet:
        print(printable("\n".join(lines)))
    return 0


def _pass_interrupts_on() -> None:
    """Interrupt again where an interrupt came in a callback, which cannot raise it.

    JAX has one in Python's garbage collector; Python only prints what is raised there.
    """
    before = sys.unraisablehook

    def repeat_interrupt(raised: "sys.UnraisableHookArgs") -> None:
        if issubclass(raised.exc_type, KeyboardInterrupt):
            # A little later, or it would be raised in here. By SIGTERM, since a shell
            # lets what it starts in the background ignore SIGINT.
            again = threading.Timer(0.05, _thread.interrupt_main, [signal.SIGTERM])
            again.start()
        else:
            before(raised)

    sys.unraisablehook = repeat_interrupt


def _interrupt(number: int, frame: object) -> NoReturn:
    """End a run that a batch system terminates as Ctrl-C does."""
    raise KeyboardInterrupt


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code.

    Args:
        argv: Arguments without the program's name; those of the process if None.

    Returns:
        0 for success, 2 for bad input, 1 for a run that failed.
    """
    commands: dict[str, Callable[..., Any]] = {
        "simulate": simulate,
        "correct": correct,
        "feed": feed,
        "stability": stability,
        "campaign": campaign,
        "identify": identify,
        "learn": learn,
        "robot": robot,
        "example": example,
        "new": new,
        "check": check,
        "convert": convert,
        "doctor": doctor,
    }
    arguments = sys.argv[1:] if argv is None else list(argv)
    if argv is None:
        signal.signal(signal.SIGTERM, _interrupt)
        _pass_interrupts_on()
    try:
        if arguments == ["--version"]:
            print(f"diffmill {metadata.version('diffmill')}")
            return 0
        if arguments[:1] == ["--completion"]:
            arguments = ["--tyro-print-completion", shell_of(arguments)]
        else:
            check_usage(commands, arguments)
        return tyro.extras.subcommand_cli_from_dict(
            commands,
            prog="diffmill",
            description="Predict and correct the path error of a milling robot. "
            "diffmill --version prints the version.",
            args=arguments,
        )
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 0 if end.code is None else 2
    except BadInput as error:
        print(printable(f"error: {error}"), file=sys.stderr)
        return 2
    except (KeyboardInterrupt, Interrupted) as error:
        state = str(error) or "no results were written"
        print(printable(f"error: interrupted; {state}"), file=sys.stderr)
        return 1
    except BrokenPipeError:
        # Who reads has enough, such as `head`; nothing more can be said there.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (OSError, MemoryError) as error:
        reason = getattr(error, "strerror", None) or error
        place = getattr(error, "filename", None)
        place = "" if place is None else f"{place}: "
        message = f"error: {place}{reason}; no results were written"
        print(printable(message), file=sys.stderr)
        return 1
