"""Checks of the instruments: identity, warm-up, self-calibration, valid certificates, the reference."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

from bench.model.drivers import manual_of
from bench.model.errors import BenchError, InstrumentError
from bench.model.ports import Instrument
from bench.plan import WIRING, PlannedPrompt, PlannedRecord
from bench.run.bus.first_contact import unproved
from bench.run.bus.safety import hurried
from bench.run.bus.side_by_side import asked
from bench.run.preflight.context import Finding, PreflightContext, Status

MARGIN = timedelta(days=1)  # holds, retakes and a late start
LAB_DEGC, LAB_WITHIN_DEGC = 23.0, 1.0  # the certificates of calibrator and meter hold for it
HOUR_S = 3600.0
ANSWER_S = 1.0
SETS = "a run sets"
_CONTACT = "'bench commission ROLE' makes one, --uncommissioned REASON goes on without"


def identities(context: PreflightContext) -> list[Finding]:
    """Every instrument of the station says who it is; model and serial number are those of the station file.

    What keeps several from being reached is one finding.
    """
    missing: dict[int, tuple[BenchError, list[str]]] = {}
    for role in context.station.instruments:
        if role in context.absent:
            error = context.absent[role]
            missing.setdefault(id(error), (error, []))[1].append(role)
    shared = {role for _, roles in missing.values() if len(roles) > 1 for role in roles}
    buses = [
        Finding(
            f"bus of {len(roles)} instruments",
            Status.FAIL,
            error.code,
            "",
            f"{error.message}; {error.next_step}",
            of_bench=True,
        )
        for error, roles in missing.values()
        if len(roles) > 1
    ]
    resources = {role: entry.resource for role, entry in context.station.instruments.items() if role not in shared}
    return [*buses, *asked(resources, lambda role: _identity(context, role), context.clock).values()]


def first_contacts(context: PreflightContext) -> list[Finding]:
    """On a real bench every command of a driver is confirmed: by a manual, or by a record of model and firmware."""
    if context.station.simulated:
        return []
    found, known = [], 0
    for role, instrument in context.instruments.items():
        entry, identity = context.station.instruments[role], getattr(instrument, "identity", None)
        manual = manual_of(entry.driver)
        if identity is None:
            continue
        status, more = (Status.WARN, context.uncommissioned) if context.uncommissioned else (Status.FAIL, _CONTACT)
        if manual is None:
            text = f"{entry.driver}.yaml beside the driver is missing: nothing says what it sends; {more}"
            found.append(Finding(f"first contact of {role}", status, "no table", "none", text, of_bench=True))
            continue
        missing = unproved(context.station.path, entry.driver, manual, identity)
        known += not missing
        if missing:
            value = f"{len(missing)} of {len(manual.commands)} commands"
            text = f"no manual shows {', '.join(missing[:3])}{' ...' if len(missing) > 3 else ''}, and no record of it"
            found.append(Finding(f"first contact of {role}", status, value, "none", f"{text}; {more}", of_bench=True))
    if not found and not known:
        return [Finding("first contact", Status.SKIPPED, text="no instrument whose commands are known answers")]
    return found or [Finding("first contact", Status.OK, f"{known} drivers", "all commands confirmed")]


def _identity(context: PreflightContext, role: str) -> Finding:
    name = f"identity of {role}"
    standard = context.station.instruments[role].standard
    due = "" if standard is None else f"{standard.model} {standard.serial}"
    try:
        if role in context.absent:
            raise context.absent[role]
        instrument = context.instruments[role]
        with hurried(instrument, ANSWER_S):  # no second try: whoever reads this is at the bench and sees what is off
            known = getattr(instrument, "identity", None)
            identity = known or (instrument.introduce() if context.asks_only else instrument.identify())
    except BenchError as error:
        return Finding(name, Status.FAIL, error.code, due, error.message, of_bench=True)
    known = identity.serial not in ("", "0")
    if known and standard is not None and identity.serial != standard.serial:
        text = "the register holds the certificate of another one"
        return Finding(name, Status.FAIL, f"{identity.model} {identity.serial}", due, text, of_bench=True)
    value = f"{identity.model} {identity.serial if known else '(tells no number)'}"
    remark = "" if known or not due else "it does not tell its serial number: compare its label"
    return Finding(name, Status.OK, value, due, remark)


def settings(context: PreflightContext, worst: Status = Status.FAIL) -> list[Finding]:
    """Tell what the last user left: what a run relies on, sets, or refuses; nothing is set to find that out.

    Instruments that were identified for a run are prepared already: they were asked before that.
    Args: worst: what it is that no command mends, and an answer that is missing; as a warning it is waited for.
    """
    if not context.asks_only:
        return []
    known = {role: each for role, each in context.instruments.items() if getattr(each, "identity", None)}
    resources = {role: context.station.instruments[role].resource for role in known}
    found = asked(resources, lambda role: _settings(role, known[role], worst), context.clock)
    return [finding for finding in found.values() if finding is not None]


def _settings(role: str, instrument: Instrument, worst: Status) -> Finding | None:
    name = f"settings of {role}"
    try:
        with hurried(instrument, ANSWER_S if worst is Status.FAIL else None):
            rows = list(instrument.state_rows())
    except InstrumentError as error:
        return Finding(name, worst, error.code, "", error.message, of_bench=True)
    refused = [row for row in rows if row.right is False and not row.command]
    if refused:
        value = ", ".join(f"{row.name} ({row.reply})" for row in refused)
        return Finding(name, worst, value, "", "; ".join(row.advice for row in refused), of_bench=True)
    changed = [f"{row.name} ({row.reply} now)" for row in rows if row.right is False]
    unseen = [row.name for row in rows if row.right is None]
    parts = [f"{len(rows) - len(unseen)} asked"]
    parts += [f"{SETS} {', '.join(changed)}"] if changed else []
    parts += [f"{SETS} unseen: {', '.join(unseen)}"] if unseen else []
    return Finding(name, Status.OK, "; ".join(parts)) if rows else None


def standards(context: PreflightContext) -> Finding:
    """The calibration of every instrument that is used, and of standards beside them, is valid to the planned end."""
    name = "calibration dates"
    start, end = context.start_utc, context.start_utc + timedelta(seconds=context.length_s)
    used = {role: context.station.instruments[role].standard for role in sorted(context.used_roles)}
    used |= context.station.file.standards
    known = {role: standard for role, standard in used.items() if standard is not None}
    if not known:
        return Finding(name, Status.WARN, text="no instrument that is used has an entry in the standards register")
    until = f"{end:%Y-%m-%d %H:%M}Z"
    wrong = [
        f"{role} ({standard.calibrated} to {standard.due})"
        for role, standard in known.items()
        if standard.calibrated > start.date() or standard.due < end.date()
    ]
    if wrong:
        text = f"{', '.join(wrong)} not valid from now until the planned end"
        return Finding(name, Status.FAIL, f"{len(wrong)} of {len(known)} not valid", until, text)
    first = min(known, key=lambda role: known[role].due)
    value = f"{first} due {known[first].due}"
    if known[first].due < (end + MARGIN).date():
        return Finding(name, Status.WARN, value, until, "a hold of a day would outlast it")
    return Finding(name, Status.OK, value, until, f"{len(known)} standards")


def warm_up(context: PreflightContext) -> list[Finding]:
    """An instrument with a declared warm-up time has been on that long, as far as it can say so itself."""
    return [
        _warm_up(context, role, instrument)
        for role, instrument in context.instruments.items()
        if role in context.used_roles and getattr(instrument, "warm_up_s", 0.0) > 0.0
    ]


def _warm_up(context: PreflightContext, role: str, instrument: Any) -> Finding:
    asked_s = _asked_s(context, role)
    due_s = max(instrument.warm_up_s, asked_s or 0.0)
    name, limit = f"warm-up of {role}", f"{due_s / HOUR_S:g} h"
    ask = getattr(instrument, "time_on_s", None)
    later = "no prompt of the sequence asks for it" if asked_s is None else "a prompt of the sequence asks for it"
    if ask is None:
        status = Status.WARN if asked_s is None else Status.SKIPPED
        return Finding(name, status, "unknown", limit, f"it does not tell how long it has been on; {later}")
    try:
        on_s = float(ask())
    except InstrumentError as error:
        return Finding(name, Status.WARN, "unknown", limit, f"it did not answer ({error.code}); {later}")
    if on_s < due_s:
        return Finding(name, Status.FAIL, f"{on_s / HOUR_S:.2f} h", limit, "wait until it is warm", of_bench=True)
    return Finding(name, Status.OK, f"{on_s / HOUR_S:.1f} h", limit, "by its own clock")


def _asked_s(context: PreflightContext, role: str) -> float | None:
    """Return the shortest time on that a prompt of the sequence accepts for an instrument, s; else None."""
    words = role.replace("_", " ")
    for step in context.plan.steps:
        if isinstance(step, PlannedPrompt) and step.unit == "s" and words in step.text:
            return step.low or 0.0
    return None


def self_calibration(context: PreflightContext) -> list[Finding]:
    """Instruments that adjust themselves have done so, lately enough and at this temperature."""
    findings = []
    for role, instrument in context.instruments.items():
        ask = getattr(instrument, "self_calibration", None)
        if ask is None or role not in context.used_roles:
            continue
        name = f"self-calibration of {role}"
        try:
            measured, limit, unit, what = ask()
        except InstrumentError as error:
            text = f"it did not answer ({error.code}); confirm it at its front panel"
            findings.append(Finding(name, Status.WARN, "unknown", "", text))
            continue
        value, due = f"{measured:.3g} {unit}", f"at most {limit:g} {unit}"
        status = Status.OK if measured <= limit else Status.FAIL
        text = what if measured <= limit else f"{what}; let it calibrate itself"
        findings.append(Finding(name, status, value, due, text, of_bench=True))
    return findings


def reference(context: PreflightContext) -> list[Finding]:
    """The counters stand on the common 10 MHz and it is there."""
    findings = []
    for role, instrument in context.instruments.items():
        ask = getattr(instrument, "reference_locked", None)
        if ask is None:
            continue
        name = f"10 MHz at {role}"
        try:
            at_once = bool(ask())
            locked = at_once or bool(ask())  # the first answer also counts what was lost before now
        except InstrumentError as error:
            findings.append(Finding(name, Status.WARN, "unknown", "external", f"it did not answer ({error.code})"))
            continue
        if context.asks_only and not locked:
            text = "a run sets it to external and looks again"
            findings.append(Finding(name, Status.WARN, "not locked", "external", text))
        elif locked:
            text = "" if at_once else "it was lost since the last question"
            findings.append(Finding(name, Status.OK if at_once else Status.WARN, "locked", "external", text))
        else:
            status = Status.FAIL if role in context.used_roles else Status.WARN
            text = "connect the common 10 MHz to its reference input"
            findings.append(Finding(name, status, "not locked", "external", text, of_bench=True))
    return findings


def generators(context: PreflightContext) -> list[Finding]:
    """A function generator does not say where its time base comes from: only a counter tells."""
    generating = [role for role in context.used_roles if hasattr(context.instruments.get(role), "square")]
    counted = any(step.name == "measure_frequency" for step in context.plan.steps)
    later = "the campaign measures it with a counter"
    if not counted:
        later = "nothing in the campaign measures it either: its certificate counts"
    text = f"no output is switched on before the run; {later}"
    return [Finding(f"frequency of {role}", Status.SKIPPED, "", "", text) for role in sorted(generating)]


def laboratory(context: PreflightContext) -> Finding:
    """The laboratory's air, by the first channel of the logger, is inside what the certificates hold for."""
    name, limit = "laboratory air", f"{LAB_DEGC:g} ± {LAB_WITHIN_DEGC:g} degC"
    instruments: Any = context.instruments.values()
    logger = next((instrument for instrument in instruments if hasattr(instrument, "scan")), None)
    if logger is None:
        return Finding(name, Status.WARN, "unknown", limit, "the station has no logger that measures it")
    if context.asks_only:
        return Finding(name, Status.SKIPPED, "", limit, "a scan would move relays: a run looks at it")
    try:
        lab_degC = float(logger.scan()[0])
    except InstrumentError as error:
        return Finding(name, Status.WARN, "unknown", limit, f"{error.code}: {error.message}")
    value = f"{lab_degC:.2f} degC"
    if abs(lab_degC - LAB_DEGC) > LAB_WITHIN_DEGC:
        return Finding(name, Status.FAIL, value, limit, "certificates do not hold there; wait", of_bench=True)
    return Finding(name, Status.OK, value, limit, "first channel of the logger")


def wiring(context: PreflightContext) -> Finding:
    """The preparation proves by small known currents that every wire goes where it should."""
    records = (step for step in context.plan.phase("prepare") if isinstance(step, PlannedRecord))
    checks = [record for record in records if record.purpose == WIRING]
    channels = sorted({int(step.conditions["channel"]) for step in checks if "channel" in step.conditions})
    if checks:
        return Finding("wiring check", Status.OK, f"{len(checks)} records, {len(channels)} channels", "in 'prepare'")
    driven = any(step.name == "operate" for step in context.plan.steps)
    if not driven:
        return Finding("wiring check", Status.SKIPPED, "none", "in 'prepare'", "the plan drives no current")
    text = "no record in 'prepare' has the purpose wiring: a swapped wire would show only in the results"
    return Finding("wiring check", Status.WARN, "none", "in 'prepare'", text)
