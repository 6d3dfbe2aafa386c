"""The ``bench`` command line: arguments in, one exit status out, never a traceback."""

from __future__ import annotations

import errno
import gc
import io
import os
import sys
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from typer import Argument, Option
from typer.exceptions import Abort, TyperException

import bench
from bench.commands import bench_app, session_app
from bench.commands.archive.app import app as archive_app
from bench.commands.frame.app import app as frame_app
from bench.commands.history.app import app as history_app
from bench.commands.requests import (
    AsJson,
    CheckRequest,
    PlanRequest,
    RunRequest,
    ServeRequest,
    SessionFolder,
    SessionsOut,
    StationName,
    StudyRequest,
    TakeOver,
)
from bench.commands.usage import App, completing
from bench.model.errors import ExitStatus, InputError
from bench.model.extras import extras_named
from bench.model.installed import OWN, checked_package, unforeseen
from bench.model.lab import TRUST, find_shipped

app = App(
    name="bench",
    help="Controller of an unattended calibration bench. 'bench COMMAND -h' shows how a command is used.",
    epilog="Exit status: 0 every verdict passes and every estimate is sound, 1 a verdict fails or is indeterminate or "
    "an estimate is doubtful, refused or missing, 2 bad input, 3 ended safely after a fault, 4 ended safely by the "
    "operator, 5 session damaged, 70 internal error; 137, said by the shell: killed, by its guard or somebody else.",
)
app.add_typer(history_app, name="history")
app.add_typer(archive_app, name="archive")
app.add_typer(frame_app, name="frame")
app.add_typer(bench_app.app)
app.add_typer(session_app.app)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(bench.__version__)
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    trust_lab: Annotated[
        bool, Option("--trust-lab", help="On Windows: load the code of this lab folder, which I have looked at.")
    ] = False,
) -> None:
    """Take the options of ``bench`` itself."""
    del version
    if trust_lab:
        os.environ[TRUST] = "1"


@app.command(work="lab.init", epilog="Example: bench init our_lab --name 'Our laboratory' --model NGU --serial 17")
def init(
    folder: Annotated[Path, Argument(help="a new folder")],
    name: Annotated[str | None, Option(help="of the laboratory")] = None,
    model: Annotated[str | None, Option(help="of the unit under test")] = None,
    serial: Annotated[str | None, Option(help="its serial number")] = None,
    station: Annotated[str | None, Option(help="the simulated bench to begin with")] = None,
) -> None:
    """Make a laboratory's own folder: sequences, stations, frames and code of its own."""


@app.command(work="lab.init", epilog="Example: bench copy gnc_unit_test --as entrance_check")
def copy(
    name: Annotated[str, Argument(help="of a shipped sequence, station or frame")],
    new: Annotated[str | None, Option("--as", metavar="NAME", help="another name for it")] = None,
) -> None:
    """Copy a shipped file into the lab folder, to be changed there."""


@app.command(work="lookup", epilog="Examples: bench explain B-PLAN-052 · bench explain tutorial")
def explain(
    topic: Annotated[str, Argument(metavar="CODE | PAGE", help="such as B-PLAN-052, or the name of a page")],
) -> None:
    """Say what an error code means and what to do; or show a page of the documentation."""


@app.command("list", work="lab.listing", epilog="Examples: bench list sequences · bench list actions hp_3458a")
def print_list(
    kind: Annotated[
        str | None,
        Argument(
            help="sequences, stations, frames, instruments or analyses; default: all of these; "
            "actions of drivers, units, options of worlds"
        ),
    ] = None,
    name: Annotated[str | None, Argument(help="only what begins so, such as a driver")] = None,
    as_json: AsJson = False,
) -> None:
    """List what a sequence or a command can name, and where it comes from: this lab folder or an installation."""


@app.command(epilog="Example: bench check scale_factor_38h --plot timetable.svg")
def check(request: CheckRequest) -> None:
    """Load, compile and check everything without touching an instrument; with --live the pre-flight of a run."""
    gc.disable()  # nothing of a check goes round in circles, and to look for that takes a tenth of its time
    try:
        from bench.commands import check as work

        work.check(request)
    finally:
        gc.enable()


@app.command(work="planning", epilog="Example: bench plan scale_factor_38h --lag '27 min' --out shorter.yaml")
def plan(request: PlanRequest) -> None:
    """Find the shortest sequence that reaches an uncertainty, and say what each change buys and what is still seen."""


@app.command(epilog="Example: bench run scale_factor_38h --clock virtual --seed 1 --out sessions")
def run(request: RunRequest) -> int:
    """Run a campaign; ends with the result table, results.json and report.html in the session's folder."""
    find_shipped("sequences", request.sequence)  # before all that runs and fits is loaded
    from bench.commands import run as work

    return work.run(request)


@app.command(work="resume", epilog="Example: bench resume sessions/20000101T000000Z_scale_factor_38h_SIM-1")
def resume(
    folder: SessionFolder,
    sequence: Annotated[str | None, Option(help="refuse to go on unless this sequence gives the same plan")] = None,
    history: Annotated[
        str | None,
        Option(metavar="URL", help="URL of the calibration history; default: beside the session"),
    ] = None,
    take_over: TakeOver = False,
    as_json: AsJson = False,
) -> None:
    """Go on with a run that crashed, lost its power, was stopped or ended by a fault; from the session's own plan."""


@app.command(epilog="Example: bench decode vn100_binary F00379 --csv vn100.csv")
def decode(
    frame: Annotated[
        str,
        Argument(help="a frame file, or the name of a shipped one", autocompletion=completing("frames")),
    ],
    file: Annotated[Path, Argument(help="a raw capture of any length; - reads standard input")],
    csv: Annotated[Path | None, Option(help="write the decoded fields")] = None,
    parquet: Annotated[Path | None, Option(help="write the decoded fields (extra 'parquet')")] = None,
    explained: Annotated[bool, Option("--explain", help="instead: what the capture itself says of its frames")] = False,
    json: AsJson = False,
) -> int:
    """Decode any raw capture with a frame definition; counts of good, bad and lost frames; status 1 if none is good."""
    if explained:
        if csv or parquet or json:
            raise typer.BadParameter("goes with none of --csv, --parquet and --json", param_hint="--explain")
        from bench.commands.frame import explain as explanation

        return explanation.explain(frame, file)
    from bench.commands.frame import decode as work

    return work.decode(frame, file, csv, parquet, json)


@app.command("import", epilog="Example: bench import docs/mappings/tckit_1v_ramp.yaml log.dsv --out sessions")
def import_(
    mapping: Annotated[Path, Argument(help="a mapping: what the columns of the log mean; the log with --guess")],
    file: Annotated[Path | None, Argument(help="a log: text, NumPy, MATLAB, HDF5, MCAP, a ROS bag")] = None,
    out: SessionsOut = Path("sessions"),
    guess: Annotated[bool, Option("--guess", help="propose a mapping for a log, on standard output")] = False,
) -> int:
    """Turn a log of another system into a session; results and report if the mapping names an analysis."""
    if guess:
        from bench.commands.guess import guess as propose

        return propose(file or mapping)
    if file is None:
        raise typer.BadParameter("name the mapping and the log, or the log with --guess", param_hint="FILE")
    from bench.commands import import_log as work

    return work.import_log(mapping, file, out)


@app.command(
    work="sim",
    epilog="Examples: bench sim af_rack_sim · bench sim fault mute dmm · bench sim fault state",
    context_settings={"ignore_unknown_options": True},  # "chamber_runaway -2" is a value
)
def sim(
    words: Annotated[
        list[str],
        Argument(metavar="STATION | fault [NAME [TARGET] [VALUE]...]", help="a station, or a fault to switch"),
    ],
    folder: Annotated[Path, Option("--dir", help="folder of the served bench")] = Path("bench-sim"),
    rate: Annotated[float, Option(help="how many times faster than real time the bench runs")] = 1.0,
    seed: Annotated[int, Option(help="of the simulated bench", min=0)] = 1,
    settings: Annotated[
        list[str] | None, Option("--set", metavar="world.OPTION=VALUE", help="change an option of the world")
    ] = None,
    clean: Annotated[bool, Option("--clean", help="instruments as after power-on, not as last left")] = False,
) -> None:
    """Serve a simulated bench in real time until Ctrl-C; with fault: list faults, switch one, clear, state."""


@app.command(work="study", epilog="Example: bench study time_sync --dask local:2 --out study")
def study(request: StudyRequest) -> None:
    """Repeat a published simulation study, many runs of each case, and hold it against the published numbers."""


@app.command(work="serve", epilog="Example: bench serve --out sessions")
def serve(request: ServeRequest) -> None:
    """Serve the live page: runs, sessions and calibrations of a folder; a process of its own that no run waits for."""


@app.command(work="schema", epilog="Example: bench schema --vscode")
def schema(
    folder: Annotated[Path, Option("--out", help="folder for the schema files")] = Path(".bench-schemas"),
    vscode: Annotated[bool, Option("--vscode", help="register them in .vscode/settings.json")] = False,
) -> None:
    """Write JSON Schemas of sequence, frame, station and results files for editors."""


@app.command(work="doctor", epilog="Example: bench doctor --station my_bench --bundle bundle.zip")
def doctor(
    station: StationName = None,
    out: SessionsOut = Path("sessions"),
    bundle: Annotated[Path | None, Option(help="write what was found, versions and the station file as a ZIP")] = None,
    as_json: AsJson = False,
) -> None:
    """Is this machine fit for a run? Clock, suspend, power, memory, versions; and the station file, if one is named."""


@app.command()
def version() -> None:
    """Print the version."""
    typer.echo(bench.__version__)


class _Stream(io.FileIO):
    """A standard stream: what it does not take is lost, and nothing fails for it.

    A full disk below standard output is told once; a reader that has gone, or a terminal that has hung up, is not.
    """

    told = False

    def write(self, data: Any, /) -> int:
        """Return how many bytes were taken or lost."""
        try:
            return super().write(data)
        except OSError as error:
            if self.fileno() == 1 and not self.told and error.errno not in (errno.EPIPE, errno.EIO):
                self.told = True
                _tell(f"standard output is lost: {error.strerror}; the exit status is that of the command")
            return len(data)


def open_streams() -> None:
    """Open standard streams that were closed by whoever started this: no file of a session takes their numbers.

    No line that cannot be written ends a command, or changes its exit status.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), mode))
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if type(stream) is io.TextIOWrapper and isinstance(getattr(stream.buffer, "raw", stream.buffer), io.FileIO):
            safe = io.BufferedWriter(_Stream(stream.fileno(), "w", closefd=False))
            # an old code page has no line to draw a table with
            errors = "backslashreplace" if stream.errors == "strict" else stream.errors
            lines = stream.line_buffering or stream.write_through
            setattr(sys, name, io.TextIOWrapper(safe, stream.encoding, errors, line_buffering=lines))


def _tell(text: str) -> None:
    typer.echo(text, err=True)


def main() -> NoReturn:
    """Entry point: BenchErrors become one clear message and their exit status."""
    open_streams()
    for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):  # read when numpy is imported, which is later
        os.environ.setdefault(variable, "1")  # the matrices are small, and no result may depend on the cores
    try:
        checked_package("bench", OWN)
        with extras_named():
            status = app(sys.argv[1:] or ["--help"], prog_name="bench", standalone_mode=False)
    except TyperException as error:
        words = error.format_message().replace("Input should be", "it should be").partition(", unable")[0]
        text = " ".join(words.split())
        _tell(str(InputError("B-CLI-011", text, next_step="add --help to see how the command is used")))
        sys.exit(ExitStatus.BAD_INPUT)
    except (Abort, KeyboardInterrupt):
        _tell("ended by the operator")
        sys.exit(ExitStatus.SAFE_BY_OPERATOR)
    except (Exception, SystemExit) as error:  # the last line of defence: a technician never sees a traceback
        problem = unforeseen(error)
        for line in (str(problem), *getattr(error, "__notes__", ())):
            _tell(line)
        if sys.stderr.isatty():  # elsewhere one error stays one line
            _tell(f"More of it: bench explain {problem.code}")
        sys.exit(problem.exit_status)
    sys.exit(status or 0)
