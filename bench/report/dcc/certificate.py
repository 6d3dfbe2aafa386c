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
_IDENTIFICATION = f"{{{DCC}}}administrativeData/{{{DCC}}}coreData/{{{DCC}}}identifications/{{{DCC}}}identification"
_IDENTIFIER = f"{{{DCC}}}administrativeData/{{{DCC}}}coreData/{{{DCC}}}uniqueIdentifier"
_HASHES = ("session", "results", "report")


@dataclass(frozen=True)
class CertifiedSession:
    """The session a certificate is of: its name and the SHA-256 of recording, results.json and report.html.

    ``hashes`` has "session", "results" and, if there was one, "report".
    """

    unique_identifier: str
    session: str
    specimen: bool
    hashes: Mapping[str, str]


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
    identifier = root.findtext(_IDENTIFIER, "")
    return CertifiedSession(identifier, values["bench_session"], identifier.startswith(f"{SPECIMEN}-"), hashes)


def _not_ours(message: str) -> InputError:
    return InputError("B-DCC-011", message, where="certificate", next_step="name a file that 'bench certificate' wrote")
