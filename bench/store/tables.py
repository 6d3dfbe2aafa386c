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

VERSION = 3
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
