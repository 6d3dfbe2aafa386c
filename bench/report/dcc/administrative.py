"""administrativeData of a certificate: software, identity, item, laboratory, customer."""

from __future__ import annotations

from bench import __version__
from bench.report.dcc.calibration import TEXTS, Calibration
from bench.report.dcc.elements import LANGUAGE, Element, dcc, leaf, words
from bench.report.dcc.laboratory import Contact, Person
from bench.report.dcc.statements import statements

ITEM_ID = "item_1"
HASH_REF = "bench_{}Sha256"


def administrative(calibration: Calibration) -> Element:
    """Return the element administrativeData."""
    return dcc(
        "administrativeData",
        dcc("dccSoftware", _own_software()),
        _ref_type_definitions(),
        _core(calibration),
        dcc("items", _item(calibration)),
        _laboratory(calibration),
        dcc("respPersons", *(_person(one) for one in calibration.laboratory.responsible)),
        _contact("customer", calibration.laboratory.customer),
        statements(calibration),
    )


def _own_software() -> Element:
    release = leaf("release", f"v{__version__}")
    return dcc("software", words("name", "inertial-bench"), release, leaf("type", "application"))


def _ref_type_definitions() -> Element:
    return dcc("refTypeDefinitions", *(_definition(name) for name in ("basic", "bench")))


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
    )


def _identifications(calibration: Calibration) -> list[Element]:
    """Order number, session and the hashes by which a certificate belongs to its session."""
    found = []
    if calibration.laboratory.order is not None:
        found.append(_identification("basic_orderNo", calibration.laboratory.order, "identification.order", "customer"))
    found.append(_identification("bench_session", str(calibration.results["session"]), "identification.session"))
    return found + [
        _identification(HASH_REF.format(name), digest, f"identification.{name}_sha256")
        for name, digest in calibration.hashes.items()
    ]


def _identification(ref_type: str, value: str, key: str, issuer: str = "calibrationLaboratory") -> Element:
    return dcc(
        "identification", leaf("issuer", issuer), leaf("value", value), words("name", TEXTS(key)), refType=ref_type
    )


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
            _identification("basic_serialNumber", str(uut["serial"]), "identification.serial", "manufacturer"),
            None if own is None else _identification("bench_customerNo", own, "identification.customer_no", "customer"),
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
