"""What a command is asked for: options that several commands have, and all those of one command as one frozen class.

A parameter of a command whose type is one of these classes stands for its fields (``bench/commands/usage.py``). What
works on a request takes it as it is, so an option is written once. Nothing heavy is loaded with this file.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from bench.commands.usage import completing
from bench.model.errors import InputError
from bench.model.segments import session_segments

if TYPE_CHECKING:
    from bench.store import Filters


def _recorded(folder: Path) -> Path:
    """Refuse a folder without a recording before what decodes and fits is loaded. Raises: InputError B-REC-010."""
    session_segments(folder)
    return folder


_SESSION = "the folder of a session"
SessionFolder = Annotated[Path, Argument(metavar="SESSION", help=_SESSION)]
RecordedSession = Annotated[Path, Argument(metavar="SESSION", help=_SESSION, callback=_recorded)]
SessionsOut = Annotated[Path, Option(help="folder for sessions")]
AsJson = Annotated[bool, Option("--json", help="print one JSON document on standard output and nothing else")]
Language = Annotated[str, Option("--lang", metavar="LANGUAGE", help="en or ko")]
SequenceName = Annotated[
    str, Argument(help="a sequence file, or the name of a shipped one", autocompletion=completing("sequences"))
]
StationName = Annotated[
    str | None,
    Option(help="a station file or name; default: the one the sequence names", autocompletion=completing("stations")),
]
Settings = Annotated[
    list[str] | None,
    Option("--set", metavar="KEY=VALUE", help="change a parameter of the sequence or world.<option>"),
]
Uncommissioned = Annotated[str, Option(metavar="REASON", help="use drivers that were never tried on these instruments")]
TakeOver = Annotated[
    bool, Option("--take-over", help="you are at the bench: send home a guard that cannot confirm everything off")
]
Unit = Annotated[str | None, Option(metavar="SERIAL", help="serial number, or 'MODEL SERIAL'")]
Campaign = Annotated[str | None, Option(help="such as scale_factor")]
Quantity = Annotated[str | None, Option(help="such as dsf_n")]
Select = Annotated[
    list[str] | None,
    Option(
        metavar="NAME=VALUE",
        help="uut, campaign, station, verdict, standard, certificate (of a standard), since, until (days)",
    ),
]
Dask = Annotated[str | None, Option(metavar="tcp://HOST:PORT|local:N", help="on a Dask cluster, or in N processes")]


@dataclass(frozen=True)
class CheckRequest:
    """``bench check``; ``out``: where sessions of a run would go; ``predict``: however long that takes."""

    sequence: SequenceName
    station: StationName = None
    settings: Settings = None
    plot: Annotated[Path | None, Option(help="draw the timetable as SVG")] = None
    live: Annotated[bool, Option("--live", help="look at the real bench too; reads only, switches nothing on")] = False
    predict: Annotated[
        bool, Option("--predict", help="predict uncertainties even where that takes much longer than the check")
    ] = False
    out: Annotated[Path, Option(help="folder for sessions, whose disk --live tries")] = Path("sessions")
    json: AsJson = False
    uncommissioned: Uncommissioned = ""


@dataclass(frozen=True)
class RunRequest:
    """``bench run``."""

    sequence: SequenceName
    station: StationName = None
    settings: Settings = None
    clock: Annotated[str | None, Option(help="virtual or wall; default: virtual on a simulated station, else wall")] = (
        None
    )
    seed: Annotated[int, Option(help="of the simulated bench", min=0)] = 1
    out: SessionsOut = Path("sessions")
    truth: Annotated[bool, Option("--truth", help="write the simulated truth beside the session")] = False
    history: Annotated[
        str | None, Option(metavar="URL", help="calibration history; default: history.sqlite in --out")
    ] = None
    json: AsJson = False
    ask: Annotated[bool, Option("--ask", help="put the prompts to a person on a simulated station too")] = False
    uncommissioned: Uncommissioned = ""


@dataclass(frozen=True)
class PlanRequest:
    """``bench plan``."""

    sequence: SequenceName
    station: Annotated[str | None, Option(help="a station file or name", autocompletion=completing("stations"))] = None
    targets: Annotated[
        list[str] | None,
        Option("--target", metavar="QUANTITY=U", help="95 %; default: random parts and coefficients as today"),
    ] = None
    within: Annotated[str | None, Option(metavar="TIME", help="the best plan in this time")] = None
    lag: Annotated[str | None, Option(metavar="TIME", help="of the unit behind the chamber's set-point")] = None
    out: Annotated[Path | None, Option(help="write the sequence")] = None
    plot: Annotated[Path | None, Option(help="draw hours against uncertainty as SVG")] = None
    json: AsJson = False


@dataclass(frozen=True)
class CertificateRequest:
    """``bench certificate``."""

    session: RecordedSession
    laboratory: Annotated[Path | None, Option(metavar="FILE", help="YAML: laboratory, customer, who signs")] = None
    out: Annotated[Path | None, Option(help="default: certificate.xml in the session's folder")] = None
    schema: Annotated[
        Path | None, Option(metavar="XSD", help="validate against this dcc.xsd (extra 'certificate')")
    ] = None
    specimen: Annotated[bool, Option("--specimen", help="a marked specimen; the only one a simulated session gets")] = (
        False
    )
    history: Annotated[str | None, Option(metavar="URL", help="where it is entered; default: beside the session")] = (
        None
    )


@dataclass(frozen=True)
class StudyRequest:
    """``bench study``; ``dask``: where to compute, None for this process."""

    name: Annotated[str, Argument(help="which study; a wrong one lists those that are installed")]
    runs: Annotated[int | None, Option(help="Monte Carlo runs of each case; default 50, with --quick 6")] = None
    seed: Annotated[int, Option(help="of all errors that are drawn", min=0)] = 1
    offsets: Annotated[str, Option(metavar="MS,MS,...", help="time offsets, milliseconds; 0 among them")] = "0,10,20,30"
    quick: Annotated[bool, Option("--quick", help="few runs, a shorter flight; what needs 50 runs is not judged")] = (
        False
    )
    dask: Annotated[
        str | None,
        Option(metavar="tcp://HOST:PORT|local:N", help="compute on a Dask cluster, or in N processes"),
    ] = None
    out: Annotated[Path, Option(help="folder for study.json and report.html")] = Path("study")
    json: Annotated[bool, Option("--json", help="print study.json on standard output and nothing else")] = False


@dataclass(frozen=True)
class ServeRequest:
    """``bench serve``; ``out`` None: the folder ``sessions``."""

    out: Annotated[Path | None, Option(help="folder of the sessions to show; default: sessions")] = None
    host: Annotated[str, Option(help="address to listen on")] = "127.0.0.1"
    port: Annotated[int, Option(help="0: any free one", min=0, max=65535)] = 8321
    cert: Annotated[Path | None, Option(help="TLS certificate, PEM")] = None
    key: Annotated[Path | None, Option(help="TLS key, PEM")] = None
    behind_proxy: Annotated[str | None, Option(metavar="URL", help="people reach it at this https address")] = None
    rotate: Annotated[bool, Option("--rotate", help="new tokens and a new key: logs everybody out")] = False
    history: Annotated[str | None, Option(metavar="URL", help="of calibrations; default: history.sqlite in --out")] = (
        None
    )
    mqtt: Annotated[str | None, Option(metavar="URL", help="tell a broker of every run: mqtts://USER@HOST/PREFIX")] = (
        None
    )


@dataclass(frozen=True)
class RefitRequest:
    """``bench archive refit``; ``with_standards``: a file, None for those that were recorded."""

    to: Annotated[Path, Option(metavar="FOLDER", help="for the outcome; the same one goes on")]
    method: Annotated[str | None, Option(help="a method of the analyses; default: their own")] = None
    with_standards: Annotated[
        Path | None, Option(metavar="FILE", help="standards in place of recorded certificates")
    ] = None
    select: Select = None
    dask: Dask = None


@dataclass(frozen=True)
class Acceptance:
    """``--accept``: doubtful values to be released, by whom and why."""

    accept: Annotated[
        list[str] | None,
        Option(metavar="QUANTITY", help="release doubtful values: dsf_n, or 'dsf_n channel=2'"),
    ] = None
    by: Annotated[str, Option(metavar="NAME", help="who accepts")] = ""
    reason: Annotated[str, Option(metavar="TEXT", help="why it is accepted")] = ""

    def asked(self) -> Sequence[str]:
        """Return the quantities to accept, none if nothing is asked. Raises: InputError B-ACC-003."""
        if not self.accept and (self.by or self.reason):
            next_step = "name the estimate: --accept QUANTITY"
            raise InputError("B-ACC-003", "--by and --reason say nothing without --accept", next_step=next_step)
        return self.accept or ()


@dataclass(frozen=True)
class AcceptanceOfUnit(Acceptance):
    """The same of the sessions of one unit."""

    accept: Annotated[
        list[str] | None, Option(metavar="QUANTITY", help="release doubtful values, as 'bench fit' does")
    ] = None


@dataclass(frozen=True)
class Place:
    """Where the history is: a URL; without one in the environment, or beside the sessions."""

    url: Annotated[
        str | None,
        Option("--history", metavar="URL", help="sqlite:///FILE or postgresql://...; default: $BENCH_HISTORY"),
    ] = None
    out: Annotated[Path | None, Option(help="folder of the sessions, with history.sqlite; default: sessions")] = None

    def of(self, sessions: Sequence[str] = ()) -> str:
        """Return the URL; the first session that is a folder says where its history lies, unless ``out`` does."""
        from bench.session.history import chosen_url

        beside = next((Path(name).resolve().parent for name in sessions if Path(name).is_dir()), Path("sessions"))
        return chosen_url(self.url, beside if self.out is None else self.out, os.environ)


@dataclass(frozen=True)
class Wanted:
    """Which calibrations of the history."""

    uut: Unit = None
    campaign: Campaign = None
    quantity: Quantity = None

    @property
    def filters(self) -> Filters:
        """Return what the history is asked for."""
        from bench.store import Filters

        return Filters(self.uut, self.campaign, self.quantity)
