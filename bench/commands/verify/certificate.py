"""Whether a certificate is of these results: the hashes it names, and every number of its results."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from bench.analysis import results_json
from bench.model.errors import InputError
from bench.report import DCC, Calibration, certificate_text, nobody, session_of
from bench.session.verification import REPORT, RESULTS, Verification

NAMES = ("certificate.xml", "certificate.specimen.xml")
FILES = {"results": RESULTS, "report": REPORT}
_RESULTS = f".//{{{DCC}}}results"
_ANY_DAY = date(2000, 1, 1)  # stands nowhere in what is compared


def check_certificates(
    found: Verification, folder: Path, manifest: Mapping[str, Any], results: Mapping[str, Any]
) -> None:
    """Compare the certificates that are in the session's folder; what a laboratory says of itself is not compared."""
    results = json.loads(results_json(results))  # as a certificate reads them: conditions in the order of the file
    for name in NAMES:
        content = found.content(folder / name) if (folder / name).exists() else None
        if content is None:
            continue
        try:
            found.add(name, *_hashes(content, folder, results), *_numbers(content, manifest, results))
        except InputError as error:
            found.add(name, error.message)


def _hashes(content: bytes, folder: Path, results: Mapping[str, Any]) -> list[str]:
    certified = session_of(content)
    wrong = []
    if certified.hashes["session"] != results["provenance"]["session_sha256"]:
        wrong.append(f"is of another recording, {certified.session} {certified.hashes['session']}")
    for key, name in FILES.items():
        path = folder / name
        if key in certified.hashes and path.is_file():
            digest = hashlib.sha256(path.read_bytes()).hexdigest()
            if digest != certified.hashes[key]:
                wrong.append(f"is of another {name}: sha256 {certified.hashes[key]} -> {digest}")
    return wrong


def _numbers(content: bytes, manifest: Mapping[str, Any], results: Mapping[str, Any]) -> list[str]:
    """Return where the results of a certificate are not those of the session."""
    specimen = session_of(content).specimen
    calibration = Calibration(results, manifest, nobody(), {}, _ANY_DAY, _ANY_DAY, specimen=specimen)
    said, due = _leaves(content), _leaves(certificate_text(calibration).encode())
    if said == due:
        return []
    if len(said) != len(due):
        return [f"its results have {len(said)} entries, the session gives {len(due)}"]
    return [f"results: {one} -> {other}" for one, other in zip(said, due, strict=True) if one != other][:5]


def _leaves(content: str | bytes) -> list[str]:
    """Return every text and name below the results, in order; references to other parts are the laboratory's."""
    found = []
    for results in ET.fromstring(content).findall(_RESULTS):
        for element in results.iter():
            marks = sorted(f"{key}={value}" for key, value in element.attrib.items() if not key.endswith("refId"))
            found.append(" ".join([element.tag.rpartition("}")[2], *marks, (element.text or "").strip()]).strip())
    return found
