"""The certificate as text, and the hashes by which one belongs to its session."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree import ElementTree as ET

from bench.model.errors import InputError
from bench.report.dcc.administrative import HASH_REF, administrative
from bench.report.dcc.calibration import SPECIMEN, Calibration
from bench.report.dcc.elements import DCC, VERSION, XSI, dcc, document_text
from bench.report.dcc.measurement import measurement

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
