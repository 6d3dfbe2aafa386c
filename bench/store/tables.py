"""The tables of the history. Numbers are double precision and come back bit by bit (but for the sign of a zero in
SQLite); times are UTC in nanoseconds.

A calibration is one session. Each set of numbers computed from it stays; a revision is what was reported and when.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from sqlalchemy import (
    BigInteger,
    Boolean,
    Column,
    Double,
    ForeignKey,
    Index,
    Integer,
    MetaData,
    Table,
    Text,
    UniqueConstraint,
)
from sqlalchemy.types import TypeEngine

VERSION = 4
METADATA = MetaData()


def _id() -> Column[int]:
    return Column("id", Integer, primary_key=True)


def _key(name: str, target: str) -> Column[int]:
    return Column(name, Integer, ForeignKey(target), nullable=False)


def _filled(kind: type[TypeEngine[Any]], *names: str) -> Iterator[Column[Any]]:
    """Yield columns of one type that are never null."""
    for name in names:
        yield Column(name, kind, nullable=False)


history = Table(
    "history",
    METADATA,
    *_filled(Integer, "version"),
    *_filled(Text, "software"),
)

calibrations = Table(
    "calibrations",
    METADATA,
    _id(),
    *_filled(Text, "session"),
    Column("session_sha256", Text, nullable=False, unique=True),
    *_filled(Text, "campaign", "uut_model", "uut_serial"),
    *_filled(BigInteger, "started_utc_ns"),
    *_filled(Boolean, "simulated"),
    *_filled(Text, "sequence", "station", "plan_sha256", "frame_sha256"),
    *_filled(BigInteger, "imported_utc_ns"),
    Index("calibrations_of_unit", "uut_serial", "uut_model", "started_utc_ns"),
)

standards = Table(
    "standards",
    METADATA,
    _key("calibration_id", "calibrations.id"),
    *_filled(Text, "role", "model", "serial", "certificate", "calibrated", "due"),
    Column("traceability_relative", Double),  # 95 %; null if the register does not state it
    UniqueConstraint("calibration_id", "role"),
)

# What a standard adds to every estimate of a quantity: two calibrations with the same certificate have it in common.
shared_components = Table(
    "shared_components",
    METADATA,
    _key("calibration_id", "calibrations.id"),
    *_filled(
        Text,
        "quantity",
        "unit",
        "role",
        "standard",  # model, serial number and certificate
    ),
    *_filled(Double, "std_uncertainty"),
    UniqueConstraint("calibration_id", "quantity"),
)

result_sets = Table(
    "result_sets",
    METADATA,
    _id(),
    _key("calibration_id", "calibrations.id"),
    *_filled(Text, "results_sha256", "method", "software"),
    Column("decision_rule", Text),
    *_filled(
        Text,
        "notes",  # JSON list
    ),
    *_filled(Integer, "estimates"),
    UniqueConstraint("calibration_id", "results_sha256"),
)

parameters = Table(
    "parameters",
    METADATA,
    _id(),
    *_filled(
        Text,
        "quantity",
        "unit",
        "conditions",  # canonical JSON, without what was measured
    ),
    Column("sha256", Text, nullable=False, unique=True),
)

# of an estimate, as results.json names them
NUMBERS = ("value", "std_uncertainty", "coverage_factor", "expanded_uncertainty")
COUNTS = ("n", "dropped")
COLUMNS = (*NUMBERS, *COUNTS, "verdict")

estimates = Table(
    "estimates",
    METADATA,
    _key("result_set_id", "result_sets.id"),
    *_filled(
        Integer,
        "position",  # in results.json
    ),
    _key("parameter_id", "parameters.id"),
    *_filled(Double, *NUMBERS),
    *_filled(Integer, *COUNTS),
    Column("limit_value", Double),
    *_filled(Text, "verdict"),
    Column("change_limit", Double),  # stability limit: how far the value may be from that of the calibration before
    Column("measured", Text),  # JSON: measured conditions
    Column("further", Text),  # JSON: fields of later versions of results.json
    UniqueConstraint("result_set_id", "position"),
    # holds all that a comparison reads, so a thousand calibrations are read from the index alone
    Index("estimates_compared", "result_set_id", "parameter_id", "value", "std_uncertainty", "coverage_factor"),
)

# What is not sound stands apart: a comparison and a drift read the estimates, and a doubtful one never enters them.
doubts = Table(
    "doubts",
    METADATA,
    _key("result_set_id", "result_sets.id"),
    *_filled(
        Integer,
        "position",  # in results.json
    ),
    _key("parameter_id", "parameters.id"),
    *_filled(
        Text,
        "verdict",
        "document",  # JSON: the entry of results.json
    ),
    UniqueConstraint("result_set_id", "position"),
)

quality_counts = Table(
    "quality_counts",
    METADATA,
    _key("result_set_id", "result_sets.id"),
    *_filled(Text, "name"),
    *_filled(BigInteger, "count"),
    UniqueConstraint("result_set_id", "name"),
)

report_revisions = Table(
    "report_revisions",
    METADATA,
    _id(),
    _key("calibration_id", "calibrations.id"),
    *_filled(Integer, "number"),
    _key("result_set_id", "result_sets.id"),
    Column("report_sha256", Text),  # null if no report was written
    *_filled(Text, "software", "reason"),
    *_filled(BigInteger, "created_utc_ns"),
    UniqueConstraint("calibration_id", "number"),
)

approvals = Table(
    "approvals",
    METADATA,
    _id(),
    _key("revision_id", "report_revisions.id"),
    *_filled(Text, "approved_by", "statement"),
    *_filled(BigInteger, "approved_utc_ns"),
)

# What people state beside the results: rows are only ever added, the newest of a calibration, unit or station counts.
# A calibration before an adjustment or repair of its unit (as_found), or after one (as_left).
states = Table(
    "states",
    METADATA,
    _id(),
    _key("calibration_id", "calibrations.id"),
    *_filled(
        Text,
        "state",
        "what",  # was adjusted or repaired
        "stated_by",
    ),
    *_filled(BigInteger, "stated_utc_ns"),
)

# Between these times a unit, or all units on a station, were in control: limits of charts rest on that.
phases = Table(
    "phases",
    METADATA,
    _id(),
    *_filled(
        Text,
        "subject",  # "unit" or "station"
        "name",  # model and serial number, or the name of the station
    ),
    *_filled(BigInteger, "from_utc_ns", "until_utc_ns"),
    *_filled(Double, "run_length"),
    *_filled(Text, "stated_by", "reason"),
    *_filled(BigInteger, "stated_utc_ns"),
)

STATED = (states, phases)

# The archive: where the recorded sessions are, and what they say of themselves (docs/decisions/0009-history.md).
archived_sessions = Table(
    "archived_sessions",
    METADATA,
    _id(),
    Column("location", Text, nullable=False, unique=True),  # URL of the folder
    *_filled(
        Text,
        "fingerprint",  # of names, sizes and times of its files: unchanged, it is passed over
    ),
    *_filled(BigInteger, "bytes"),
    *_filled(Text, "session"),
    Column("session_sha256", Text),  # null if it was never read whole
    *_filled(Text, "campaign", "station"),
    Column("started_utc_ns", BigInteger),
    *_filled(Boolean, "simulated"),
    *_filled(
        Text,
        "plan_sha256",
        "frame_sha256",
        "software",  # of the released results, as the method and what follows
        "method",
        "verdict",  # the worst
        "quality",  # the worst; "" without results
        "code",  # of the error, "" for a whole session
        "fault",
    ),
    *_filled(BigInteger, "verified_utc_ns"),
    Index("archived_by_hash", "session_sha256"),
    Index("archived_by_time", "campaign", "station", "verdict", "started_utc_ns"),
)

archived_units = Table(
    "archived_units",
    METADATA,
    _key("archived_id", "archived_sessions.id"),
    *_filled(
        Boolean,
        "check_standard",  # beside the unit under test, to watch the bench
    ),
    *_filled(Text, "model", "serial"),
    UniqueConstraint("archived_id", "model", "serial"),
    Index("archived_of_unit", "serial", "archived_id"),
)

archived_standards = Table(
    "archived_standards",
    METADATA,
    _key("archived_id", "archived_sessions.id"),
    *_filled(Text, "role", "model", "serial", "certificate"),
    UniqueConstraint("archived_id", "role"),
    Index("archived_of_standard", "serial", "archived_id"),
    Index("archived_of_certificate", "certificate", "archived_id"),
)

certificates = Table(
    "certificates",
    METADATA,
    _id(),
    *_filled(Text, "number"),
    Column("certificate_sha256", Text, nullable=False, unique=True),
    *_filled(Text, "session", "session_sha256", "results_sha256"),
    Column("report_sha256", Text),
    *_filled(
        Text,
        "uut_model",
        "uut_serial",
        "customer",
        "issued",  # day, "" for a specimen
    ),
    *_filled(Boolean, "specimen"),
    Column("replaces", Text),  # number of the certificate that it stands for
    *_filled(Text, "software", "method"),
    *_filled(BigInteger, "entered_utc_ns"),
    Index("certificates_of_session", "session_sha256"),
    Index("certificates_by_number", "number"),
)

certified_standards = Table(
    "certified_standards",
    METADATA,
    _key("certificate_id", "certificates.id"),
    *_filled(Text, "role", "model", "serial", "certificate"),
    UniqueConstraint("certificate_id", "role"),
)

# A trial says what archived sessions would give; nothing in it is released, and nothing released is changed by it.
trials = Table(
    "trials",
    METADATA,
    _id(),
    Column("name", Text, nullable=False, unique=True),  # digest of all that its numbers depend on
    *_filled(
        Text,
        "software",
        "method",  # "" for the one of each campaign
        "register",  # JSON: the standards in place of recorded certificates
        "selection",  # JSON
    ),
    *_filled(Integer, "sessions"),
    *_filled(BigInteger, "started_utc_ns"),
    *_filled(
        Text,
        "state",  # running, done
    ),
)

trial_rows = Table(
    "trial_rows",
    METADATA,
    _key("trial_id", "trials.id"),
    *_filled(Text, "session_sha256"),
    *_filled(Integer, "position"),
    Column("parameter_id", Integer, ForeignKey("parameters.id")),  # null for a session that gave nothing
    *_filled(Text, "uut_model", "uut_serial"),
    Column("value", Double),  # null if it is refused, or there is none any more
    Column("expanded_uncertainty", Double),
    *_filled(
        Text,
        "verdict",
        "quality",  # "" where there is no such estimate
        "method",
    ),
    Column("released_value", Double),
    Column("released_expanded_uncertainty", Double),
    *_filled(
        Text,
        "released_verdict",
        "released_quality",
        "released_method",
        "released_software",
        "code",  # of the error that kept the session from giving results, else ""
        "fault",
    ),
    UniqueConstraint("trial_id", "session_sha256", "position"),
)

ARCHIVE = (
    archived_sessions, archived_units, archived_standards, certificates, certified_standards, trials, trial_rows,
)  # fmt: skip
