"""Sequence and station files, the compiled plan, and its static check."""

from bench.plan.check.actions import bus_s
from bench.plan.check.analysis import names_made_of_logs
from bench.plan.check.everything import check_plan
from bench.plan.check.stations import check_station, recorded_rules
from bench.plan.compile import compile_sequence
from bench.plan.deciding import is_other_length
from bench.plan.decision import FAIL, HOLD, PlannedDecision, decisions_of, left_out_by, unmet_loops
from bench.plan.expected import is_answered, is_reading, roles_of, round_count, values_not_due
from bench.plan.findings import Findings, suggestion
from bench.plan.frozen import frozen_plan, plan_of_texts
from bench.plan.language.graphs import COUNTS, Graph, GraphEntry, graphs_of, shown_signals
from bench.plan.language.interlocks import Action, InterlockRule
from bench.plan.language.mapping import (
    ELAPSED,
    ISO,
    ROWS,
    SAMPLES,
    UNIX,
    FileForm,
    LogMapping,
    Overload,
    TimeColumn,
    language_of_mapping,
    load_mapping,
)
from bench.plan.language.notices import Apprise, Mail, Notify, Webhook, web_address
from bench.plan.language.sequence import Early
from bench.plan.language.standards import Date, Standard, Stated, Words, told_standard
from bench.plan.plan import KINDS, Phase, Plan, PlannedUnit, SetPoint, Step, Steps, steps_sha256
from bench.plan.planned_air import LAB_AIR_degC, planned_temperature, timed_steps
from bench.plan.schemas import json_schemas, mapping_schema, vscode_settings
from bench.plan.served import served_station
from bench.plan.station import Station, StationFile, declared_action, driver_actions, load_station, station_drivers
from bench.plan.step_kinds import (
    CHAMBER,
    MEASUREMENT,
    WIRING,
    PlannedCall,
    PlannedCommand,
    PlannedPrompt,
    PlannedRecord,
    PlannedSend,
    PlannedSettle,
    PlannedSoak,
    PlannedVerify,
    expected_reading,
    is_measurement,
    plan_json,
    steps_of,
)
from bench.plan.summary import SECOND_BYTES, Summary, summarise, unwatched
from bench.plan.values import SUFFIX, UNIT

__all__ = [
    "CHAMBER",
    "COUNTS",
    "ELAPSED",
    "FAIL",
    "HOLD",
    "ISO",
    "KINDS",
    "MEASUREMENT",
    "ROWS",
    "SAMPLES",
    "SECOND_BYTES",
    "SUFFIX",
    "UNIT",
    "UNIX",
    "WIRING",
    "Action",
    "Apprise",
    "Date",
    "Early",
    "FileForm",
    "Findings",
    "Graph",
    "GraphEntry",
    "InterlockRule",
    "LAB_AIR_degC",
    "LogMapping",
    "Mail",
    "Notify",
    "Overload",
    "Phase",
    "Plan",
    "PlannedCall",
    "PlannedCommand",
    "PlannedDecision",
    "PlannedPrompt",
    "PlannedRecord",
    "PlannedSend",
    "PlannedSettle",
    "PlannedSoak",
    "PlannedUnit",
    "PlannedVerify",
    "SetPoint",
    "Standard",
    "Stated",
    "Station",
    "StationFile",
    "Step",
    "Steps",
    "Summary",
    "TimeColumn",
    "Webhook",
    "Words",
    "bus_s",
    "check_plan",
    "check_station",
    "compile_sequence",
    "decisions_of",
    "declared_action",
    "driver_actions",
    "expected_reading",
    "frozen_plan",
    "graphs_of",
    "is_answered",
    "is_measurement",
    "is_other_length",
    "is_reading",
    "json_schemas",
    "language_of_mapping",
    "left_out_by",
    "load_mapping",
    "load_station",
    "mapping_schema",
    "names_made_of_logs",
    "plan_json",
    "plan_of_texts",
    "planned_temperature",
    "recorded_rules",
    "roles_of",
    "round_count",
    "served_station",
    "shown_signals",
    "station_drivers",
    "steps_of",
    "steps_sha256",
    "suggestion",
    "summarise",
    "timed_steps",
    "told_standard",
    "unmet_loops",
    "unwatched",
    "values_not_due",
    "vscode_settings",
    "web_address",
]
