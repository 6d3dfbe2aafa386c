"""The tables of the history. Numbers are double precision and come back bit by bit (but for the sign of a zero in
SQLite); times are UTC in nanoseconds.

A calibration is one session. Each set of numbers computed from it stays; a revision is what was reported and when.
"""

from __future__ import annotations

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

VERSION = 4
METADATA = MetaData()


def _key(name: str, target: str) -> Column[int]:
    return Column(name, Integer, ForeignKey(target), nullable=False)


history = Table(
    "history",
    METADATA,
    Column("version", Integer, nullable=False),
    Column("software", Text, nullable=False),
)

calibrations = Table(
    "calibrations",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("session", Text, nullable=False),
    Column("session_sha256", Text, nullable=False, unique=True),
    Column("campaign", Text, nullable=False),
    Column("uut_model", Text, nullable=False),
    Column("uut_serial", Text, nullable=False),
    Column("started_utc_ns", BigInteger, nullable=False),
    Column("simulated", Boolean, nullable=False),
    Column("sequence", Text, nullable=False),
    Column("station", Text, nullable=False),
    Column("plan_sha256", Text, nullable=False),
    Column("frame_sha256", Text, nullable=False),
    Column("imported_utc_ns", BigInteger, nullable=False),
    Index("calibrations_of_unit", "uut_serial", "uut_model", "started_utc_ns"),
)

standards = Table(
    "standards",
    METADATA,
    _key("calibration_id", "calibrations.id"),
    Column("role", Text, nullable=False),
    Column("model", Text, nullable=False),
    Column("serial", Text, nullable=False),
    Column("certificate", Text, nullable=False),
    Column("calibrated", Text, nullable=False),
    Column("due", Text, nullable=False),
    Column("traceability_relative", Double),  # 95 %; null if the register does not state it
    UniqueConstraint("calibration_id", "role"),
)

# What a standard adds to every estimate of a quantity: two calibrations with the same certificate have it in common.
shared_components = Table(
    "shared_components",
    METADATA,
    _key("calibration_id", "calibrations.id"),
    Column("quantity", Text, nullable=False),
    Column("unit", Text, nullable=False),
    Column("role", Text, nullable=False),
    Column("standard", Text, nullable=False),  # model, serial number and certificate
    Column("std_uncertainty", Double, nullable=False),
    UniqueConstraint("calibration_id", "quantity"),
)

result_sets = Table(
    "result_sets",
    METADATA,
    Column("id", Integer, primary_key=True),
    _key("calibration_id", "calibrations.id"),
    Column("results_sha256", Text, nullable=False),
    Column("method", Text, nullable=False),
    Column("software", Text, nullable=False),
    Column("decision_rule", Text),
    Column("notes", Text, nullable=False),  # JSON list
    Column("estimates", Integer, nullable=False),
    UniqueConstraint("calibration_id", "results_sha256"),
)

parameters = Table(
    "parameters",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("quantity", Text, nullable=False),
    Column("unit", Text, nullable=False),
    Column("conditions", Text, nullable=False),  # canonical JSON, without what was measured
    Column("sha256", Text, nullable=False, unique=True),
)

estimates = Table(
    "estimates",
    METADATA,
    _key("result_set_id", "result_sets.id"),
    Column("position", Integer, nullable=False),  # in results.json
    _key("parameter_id", "parameters.id"),
    Column("value", Double, nullable=False),
    Column("std_uncertainty", Double, nullable=False),
    Column("coverage_factor", Double, nullable=False),
    Column("expanded_uncertainty", Double, nullable=False),
    Column("n", Integer, nullable=False),
    Column("dropped", Integer, nullable=False),
    Column("limit_value", Double),
    Column("verdict", Text, nullable=False),
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
    Column("position", Integer, nullable=False),  # in results.json
    _key("parameter_id", "parameters.id"),
    Column("verdict", Text, nullable=False),
    Column("document", Text, nullable=False),  # JSON: the entry of results.json
    UniqueConstraint("result_set_id", "position"),
)

quality_counts = Table(
    "quality_counts",
    METADATA,
    _key("result_set_id", "result_sets.id"),
    Column("name", Text, nullable=False),
    Column("count", BigInteger, nullable=False),
    UniqueConstraint("result_set_id", "name"),
)

report_revisions = Table(
    "report_revisions",
    METADATA,
    Column("id", Integer, primary_key=True),
    _key("calibration_id", "calibrations.id"),
    Column("number", Integer, nullable=False),
    _key("result_set_id", "result_sets.id"),
    Column("report_sha256", Text),  # null if no report was written
    Column("software", Text, nullable=False),
    Column("reason", Text, nullable=False),
    Column("created_utc_ns", BigInteger, nullable=False),
    UniqueConstraint("calibration_id", "number"),
)

approvals = Table(
    "approvals",
    METADATA,
    Column("id", Integer, primary_key=True),
    _key("revision_id", "report_revisions.id"),
    Column("approved_by", Text, nullable=False),
    Column("statement", Text, nullable=False),
    Column("approved_utc_ns", BigInteger, nullable=False),
)

# The archive: where the recorded sessions are, and what they say of themselves (docs/decisions/0042-archive.md).
archived_sessions = Table(
    "archived_sessions",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("location", Text, nullable=False, unique=True),  # URL of the folder
    Column("fingerprint", Text, nullable=False),  # of names, sizes and times of its files: unchanged, it is passed over
    Column("bytes", BigInteger, nullable=False),
    Column("session", Text, nullable=False),
    Column("session_sha256", Text),  # null if it was never read whole
    Column("campaign", Text, nullable=False),
    Column("station", Text, nullable=False),
    Column("started_utc_ns", BigInteger),
    Column("simulated", Boolean, nullable=False),
    Column("plan_sha256", Text, nullable=False),
    Column("frame_sha256", Text, nullable=False),
    Column("software", Text, nullable=False),  # of the released results, as the method and what follows
    Column("method", Text, nullable=False),
    Column("verdict", Text, nullable=False),  # the worst
    Column("quality", Text, nullable=False),  # the worst; "" without results
    Column("code", Text, nullable=False),  # of the error, "" for a whole session
    Column("fault", Text, nullable=False),
    Column("verified_utc_ns", BigInteger, nullable=False),
    Index("archived_by_hash", "session_sha256"),
    Index("archived_by_time", "campaign", "station", "verdict", "started_utc_ns"),
)

archived_units = Table(
    "archived_units",
    METADATA,
    _key("archived_id", "archived_sessions.id"),
    Column("check_standard", Boolean, nullable=False),  # beside the unit under test, to watch the bench
    Column("model", Text, nullable=False),
    Column("serial", Text, nullable=False),
    UniqueConstraint("archived_id", "model", "serial"),
    Index("archived_of_unit", "serial", "archived_id"),
)

archived_standards = Table(
    "archived_standards",
    METADATA,
    _key("archived_id", "archived_sessions.id"),
    Column("role", Text, nullable=False),
    Column("model", Text, nullable=False),
    Column("serial", Text, nullable=False),
    Column("certificate", Text, nullable=False),
    UniqueConstraint("archived_id", "role"),
    Index("archived_of_standard", "serial", "archived_id"),
    Index("archived_of_certificate", "certificate", "archived_id"),
)

certificates = Table(
    "certificates",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("number", Text, nullable=False),
    Column("certificate_sha256", Text, nullable=False, unique=True),
    Column("session", Text, nullable=False),
    Column("session_sha256", Text, nullable=False),
    Column("results_sha256", Text, nullable=False),
    Column("report_sha256", Text),
    Column("uut_model", Text, nullable=False),
    Column("uut_serial", Text, nullable=False),
    Column("customer", Text, nullable=False),
    Column("issued", Text, nullable=False),  # day, "" for a specimen
    Column("specimen", Boolean, nullable=False),
    Column("replaces", Text),  # number of the certificate that it stands for
    Column("software", Text, nullable=False),
    Column("method", Text, nullable=False),
    Column("entered_utc_ns", BigInteger, nullable=False),
    Index("certificates_of_session", "session_sha256"),
    Index("certificates_by_number", "number"),
)

certified_standards = Table(
    "certified_standards",
    METADATA,
    _key("certificate_id", "certificates.id"),
    Column("role", Text, nullable=False),
    Column("model", Text, nullable=False),
    Column("serial", Text, nullable=False),
    Column("certificate", Text, nullable=False),
    UniqueConstraint("certificate_id", "role"),
)

# A trial says what archived sessions would give; nothing in it is released, and nothing released is changed by it.
trials = Table(
    "trials",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("name", Text, nullable=False, unique=True),  # digest of all that its numbers depend on
    Column("software", Text, nullable=False),
    Column("method", Text, nullable=False),  # "" for the one of each campaign
    Column("register", Text, nullable=False),  # JSON: the standards in place of recorded certificates
    Column("selection", Text, nullable=False),  # JSON
    Column("sessions", Integer, nullable=False),
    Column("started_utc_ns", BigInteger, nullable=False),
    Column("state", Text, nullable=False),  # running, done
)

trial_rows = Table(
    "trial_rows",
    METADATA,
    _key("trial_id", "trials.id"),
    Column("session_sha256", Text, nullable=False),
    Column("position", Integer, nullable=False),
    Column("parameter_id", Integer, ForeignKey("parameters.id")),  # null for a session that gave nothing
    Column("uut_model", Text, nullable=False),
    Column("uut_serial", Text, nullable=False),
    Column("value", Double),  # null if it is refused, or there is none any more
    Column("expanded_uncertainty", Double),
    Column("verdict", Text, nullable=False),
    Column("quality", Text, nullable=False),  # "" where there is no such estimate
    Column("method", Text, nullable=False),
    Column("released_value", Double),
    Column("released_expanded_uncertainty", Double),
    Column("released_verdict", Text, nullable=False),
    Column("released_quality", Text, nullable=False),
    Column("released_method", Text, nullable=False),
    Column("released_software", Text, nullable=False),
    Column("code", Text, nullable=False),  # of the error that kept the session from giving results, else ""
    Column("fault", Text, nullable=False),
    UniqueConstraint("trial_id", "session_sha256", "position"),
)

ARCHIVE = (
    archived_sessions, archived_units, archived_standards, certificates, certified_standards, trials, trial_rows,
)  # fmt: skip
