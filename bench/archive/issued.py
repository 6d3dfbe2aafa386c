"""Certificates that are issued, as the archive keeps them: by what is in them, whoever wrote the file."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

from bench.report import session_of
from bench.store import Issued, UsedStandard, enter_certificate


def standards_of(manifest: Mapping[str, Any]) -> tuple[UsedStandard, ...]:
    """Return the standards of a session with their certificates, by role."""
    return tuple(
        UsedStandard(role, *(str(entry.get(name, "")) for name in ("model", "serial", "certificate")))
        for role, entry in sorted(manifest.get("standards", {}).items())
    )


def issued_of(certificate: bytes, results: Mapping[str, Any], standards: tuple[UsedStandard, ...]) -> Issued:
    """Return what the archive keeps of a certificate. Raises: InputError B-DCC-011 if it is none of this bench."""
    said = session_of(certificate)
    model, serial = said.uut
    return Issued(
        number=said.unique_identifier,
        certificate_sha256=hashlib.sha256(certificate).hexdigest(),
        session=said.session,
        session_sha256=said.hashes["session"],
        results_sha256=said.hashes["results"],
        report_sha256=said.hashes.get("report"),
        uut_model=model,
        uut_serial=serial,
        customer=said.customer,
        issued=said.issued,
        specimen=said.specimen,
        replaces=said.replaces,
        software=str(results["provenance"]["software"]),
        method=str(results["method"]),
        standards=standards,
    )


def enter_issued(url: str, certificate: bytes, results: Mapping[str, Any], manifest: Mapping[str, Any]) -> None:
    """Enter a certificate with its number, hashes, standards and customer.

    Args:   url: of a history that exists.   results: the certified ones.   manifest: of the session.
    Raises: StoreError B-STORE-001 to B-STORE-007.
    """
    enter_certificate(url, issued_of(certificate, results, standards_of(manifest)))
