"""The certificate as text, and the hashes by which one belongs to its session.

administrativeData of a certificate: software, identity, item, laboratory, customer, and its statements.

Statements say what it is and is not; coverage, traceability, decision rule, verdicts, restrictions.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from xml.etree import ElementTree as ET

from bench import __version__
from bench.analysis import DOUBTFUL, REFUSED, doubt_lines, is_sound
from bench.maths.verdict import count_verdicts
from bench.model.errors import InputError
from bench.report.dcc.calibration import ITEM_ID, SPECIMEN, TEXTS, Calibration
from bench.report.dcc.elements import DCC, LANGUAGE, VERSION, XSI, Element, dcc, document_text, leaf, words
from bench.report.dcc.measurement import identification, measurement, overdue
from bench.report.dcc.results import STATUS, left_out
from bench.report.laboratory import Contact, Laboratory, Person, not_covered

HASH_REF = "bench_{}Sha256"


def administrative(calibration: Calibration) -> Element:
    """Return the element administrativeData."""
    return dcc(
        "administrativeData",
        dcc("dccSoftware", _own_software()),
        dcc("refTypeDefinitions", *map(_definition, ("basic", "bench"))),
        _core(calibration),
        dcc("items", _item(calibration)),
        _laboratory(calibration),
        dcc("respPersons", *(_person(person) for person in calibration.laboratory.responsible)),
        _contact("customer", calibration.laboratory.customer),
        dcc("statements", *_statements(calibration)),
    )


def _own_software() -> Element:
    release = leaf("release", f"v{__version__}")
    return dcc("software", words("name", "inertial-bench"), release, leaf("type", "application"))


def _definition(name: str) -> Element:
    return dcc(
        "refTypeDefinition",
        words("name", TEXTS(f"ref_type.{name}")),
        leaf("namespace", name),
        leaf("link", TEXTS(f"ref_type.{name}.link")),
    )


def _core(calibration: Calibration) -> Element:
    laboratory = calibration.laboratory
    return dcc(
        "coreData",
        leaf("countryCodeISO3166_1", laboratory.laboratory.country),
        leaf("usedLangCodeISO639_1", LANGUAGE),
        leaf("mandatoryLangCodeISO639_1", LANGUAGE),
        leaf("uniqueIdentifier", calibration.unique_identifier),
        dcc("identifications", *_identifications(calibration)),
        leaf("receiptDate", laboratory.received),
        leaf("beginPerformanceDate", calibration.began),
        leaf("endPerformanceDate", calibration.ended),
        leaf("performanceLocation", laboratory.location),
        leaf("issueDate", calibration.issued),
        _replaced(laboratory),
    )


def _replaced(laboratory: Laboratory) -> Element | None:
    if laboratory.replaces is None:
        return None
    change = leaf("typeOfChange", "amended")
    return dcc("reportAmendedSubstituted", change, leaf("replacedUniqueIdentifier", laboratory.replaces.number))


def _identifications(calibration: Calibration) -> list[Element]:
    """Order number, session and the hashes by which a certificate belongs to its session."""
    identifications = []
    if calibration.laboratory.order is not None:
        identifications.append(
            identification("basic_orderNo", calibration.laboratory.order, "identification.order", "customer")
        )
    identifications.append(
        identification("bench_session", str(calibration.results["session"]), "identification.session")
    )
    return identifications + [
        identification(HASH_REF.format(name), digest, f"identification.{name}_sha256")
        for name, digest in calibration.hashes.items()
    ]


def _item(calibration: Calibration) -> Element:
    uut, item = calibration.results["uut"], calibration.laboratory.item
    own = item.customer_number
    return dcc(
        "item",
        words("name", calibration.marked(item.name)),
        None if item.manufacturer is None else dcc("manufacturer", words("name", item.manufacturer)),
        leaf("model", uut["model"]),
        dcc(
            "identifications",
            identification("basic_serialNumber", str(uut["serial"]), "identification.serial", "manufacturer"),
            None if own is None else identification("bench_customerNo", own, "identification.customer_no", "customer"),
        ),
        id=ITEM_ID,
    )


def _laboratory(calibration: Calibration) -> Element:
    own = calibration.laboratory.laboratory
    return dcc("calibrationLaboratory", leaf("calibrationLaboratoryCode", own.code), _contact("contact", own))


def _contact(tag: str, contact: Contact) -> Element:
    location = dcc(
        "location",
        leaf("city", contact.city),
        leaf("countryCode", contact.country),
        leaf("postCode", contact.post_code),
        leaf("street", contact.street),
        leaf("streetNo", contact.street_number),
    )
    return dcc(tag, words("name", contact.name), leaf("eMail", contact.e_mail), leaf("phone", contact.phone), location)


def _person(person: Person) -> Element:
    signs = leaf("mainSigner", "true") if person.signs else None
    return dcc("respPerson", dcc("person", words("name", person.name)), leaf("role", person.role), signs)


def _statements(calibration: Calibration) -> Iterator[Element]:
    """Yield every statement in its order; standards that are overdue only a specimen can have."""
    laboratory, estimates = calibration.laboratory, calibration.estimates
    if calibration.specimen:
        key = "statement.simulated" if calibration.simulated else "statement.specimen"
        yield _statement(TEXTS(key), "bench_specimen")
    yield _statement(TEXTS("statement.scope"), norm="ISO/IEC 17025:2017", reference="7.8.2.1 l)")
    yield _statement(TEXTS("statement.coverage"), "basic_methodMeasurementUncertainty", norm="JCGM 100:2008")
    yield _statement(laboratory.traceability, "bench_traceability", norm="ISO/IEC 17025:2017", reference="7.8.4.1 c)")
    if late := overdue(calibration.manifest.get("standards", {}), calibration.began, calibration.ended):
        yield _statement(TEXTS("statement.overdue", standards="; ".join(late)), "bench_overdue")
    yield from _of_the_laboratory(laboratory)
    yield from _accreditation(calibration)
    yield from _conformity(calibration)
    if names := Counter(estimate.quantity for estimate in estimates if is_sound(estimate) and left_out(estimate)):
        listed = ", ".join(f"{count} {name}" for name, count in sorted(names.items()))
        yield _statement(TEXTS("statement.left_out", listed=listed), "bench_leftOut")
    if counted := Counter(str(estimate.quality) for estimate in estimates if not is_sound(estimate)):
        counts = ", ".join(f"{counted[name]} {name}" for name in (REFUSED, DOUBTFUL) if counted[name])
        why = " ".join(doubt_lines(estimates))  # accepted values stay out too
        yield _statement(TEXTS("statement.not_sound", counts=counts, why=why), "bench_notSound")
    yield _statement(TEXTS("statement.quality", **calibration.results["quality"]), "bench_quality")
    for note in calibration.results.get("notes", ()):
        yield _statement(note, "bench_note")
    for text in laboratory.statements:
        yield _statement(text, "bench_laboratoryStatement")


def _statement(
    text: str, ref_type: str | None = None, *, norm: str = "", reference: str = "", conformity: str | None = None
) -> Element:
    return dcc(
        "statement",
        leaf("norm", norm),
        leaf("reference", reference),
        words("declaration", text),
        leaf("conformity", conformity),
        refType=ref_type,
    )


def _of_the_laboratory(laboratory: Laboratory) -> list[Element]:
    """Return the state of the item, an adjustment, what is replaced and why, and a next day that was agreed on."""
    texts = {} if laboratory.item.state is None else {"state": TEXTS("statement.state", state=laboratory.item.state)}
    if (adjusted := laboratory.adjustment) is not None:
        other = "" if adjusted.other is None else TEXTS("statement.adjustment.other", number=adjusted.other)
        texts["adjustment"] = f"{TEXTS(f'statement.adjustment.{adjusted.results}', what=adjusted.what)} {other}"
    if (replaced := laboratory.replaces) is not None:
        texts["replaces"] = TEXTS("statement.replaces", number=replaced.number, reason=replaced.reason)
    if laboratory.next_calibration is not None:
        texts["nextCalibration"] = TEXTS("statement.next", day=laboratory.next_calibration.day)
    return [_statement(text, f"bench_{name}") for name, text in texts.items()]


def _accreditation(calibration: Calibration) -> list[Element]:
    """Return what is stated under the accreditation, and what is not; nothing of a specimen is."""
    own = calibration.laboratory.accreditation
    if own is None or calibration.specimen:
        return []
    sound = [estimate for estimate in calibration.estimates if is_sound(estimate)]
    sound = [estimate for estimate in sound if not left_out(estimate)]
    outside = not_covered(own, str(calibration.results["campaign"]), sound)
    covered = sorted({str(estimate.quantity) for estimate in sound} - set(outside))
    key = "statement.accredited_part" if covered else "statement.not_accredited"
    names = {"covered": ", ".join(covered), "outside": ", ".join(sorted(outside))}
    text = TEXTS(key if outside else "statement.accredited", body=own.body, number=own.number, **names)
    return [_statement(text, "bench_accreditation")]


def _conformity(calibration: Calibration) -> list[Element]:
    counted = count_verdicts(estimate.verdict for estimate in calibration.estimates if estimate.verdict in STATUS)
    if not counted:
        return [_statement(TEXTS("statement.not_judged"), "bench_decisionRule")]
    rule = str(calibration.results.get("decision_rule") or "non_binary")
    tally = ", ".join(f"{count} {STATUS[verdict]}" for verdict, count in counted.items())
    whole = all(is_sound(estimate) for estimate in calibration.estimates)
    judged = TEXTS("statement.judged" if whole else "statement.judged_part", count=sum(counted.values()), tally=tally)
    return [
        _statement(TEXTS(f"rule.{rule}"), "bench_decisionRule", norm="JCGM 106:2012", reference="ILAC-G8:09/2019"),
        _statement(judged, "basic_conformity", conformity=STATUS[next(iter(counted))]),
    ]


_LOCATION = f"{DCC} https://ptb.de/dcc/v{VERSION}/dcc.xsd"
CERTIFICATE_FILE, SPECIMEN_FILE = "certificate.xml", "certificate.specimen.xml"  # in the folder of the session
_DATA = f"{{{DCC}}}administrativeData"
_CORE = f"{_DATA}/{{{DCC}}}coreData"
_IDENTIFICATION = f"{_CORE}/{{{DCC}}}identifications/{{{DCC}}}identification"
_ITEM = f"{_DATA}/{{{DCC}}}items/{{{DCC}}}item"
_SERIAL = f"{_ITEM}/{{{DCC}}}identifications/{{{DCC}}}identification[@refType='basic_serialNumber']/{{{DCC}}}value"
_CUSTOMER = f"{_DATA}/{{{DCC}}}customer/{{{DCC}}}name/{{{DCC}}}content"
_REPLACED = f"{_CORE}/{{{DCC}}}reportAmendedSubstituted/{{{DCC}}}replacedUniqueIdentifier"
_HASHES = ("session", "results", "report")


@dataclass(frozen=True)
class CertifiedSession:
    """The session a certificate is of: its name and the SHA-256 of recording, results.json and report.html.

    ``hashes`` has "session", "results" and, if there was one, "report".   ``issued``: day, "" if it does not say.
    ``replaces``: number of the certificate that it stands for.
    """

    unique_identifier: str
    session: str
    specimen: bool
    hashes: Mapping[str, str]
    uut: tuple[str, str]  # model and serial number
    customer: str
    issued: str
    replaces: str | None


def certificate_text(calibration: Calibration) -> str:
    """Return the certificate as XML, the same bytes for the same calibration.

    Raises: InputError B-DCC-007 for an estimate whose unit has no form in D-SI.
    """
    root = dcc("digitalCalibrationCertificate", administrative(calibration), measurement(calibration))
    root.set("schemaVersion", VERSION)
    root.set(f"{{{XSI}}}schemaLocation", _LOCATION)
    return document_text(root)


def session_of(certificate: bytes) -> CertifiedSession:
    """Return the session a certificate of this bench belongs to. Raises: InputError B-DCC-011 for any other."""
    try:
        root = ET.fromstring(certificate)
    except ET.ParseError as error:
        raise _not_ours(f"is not XML: {error}") from error
    values = {
        identification.get("refType", ""): identification.findtext(f"{{{DCC}}}value", "")
        for identification in root.findall(_IDENTIFICATION)
    }
    hashes = {name: values[ref] for name in _HASHES if (ref := HASH_REF.format(name)) in values}
    if "bench_session" not in values or not {"session", "results"} <= hashes.keys():
        raise _not_ours("is not a certificate that this software wrote")
    identifier = root.findtext(f"{_CORE}/{{{DCC}}}uniqueIdentifier", "")
    return CertifiedSession(
        identifier,
        values["bench_session"],
        identifier.startswith(f"{SPECIMEN}-"),
        hashes,
        (root.findtext(f"{_ITEM}/{{{DCC}}}model", ""), root.findtext(_SERIAL, "")),
        root.findtext(_CUSTOMER, ""),
        root.findtext(f"{_CORE}/{{{DCC}}}issueDate", ""),
        root.findtext(_REPLACED),
    )


def _not_ours(message: str) -> InputError:
    return InputError("B-DCC-011", message, where="certificate", next_step="name a file that 'bench certificate' wrote")
