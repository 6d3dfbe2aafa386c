"""Digital Calibration Certificates: PTB DCC 3.2.1 with D-SI units."""

from bench.report.dcc.calibration import Calibration, Span, nobody
from bench.report.dcc.certificate import certificate_text, session_of
from bench.report.dcc.elements import DCC
from bench.report.dcc.laboratory import Laboratory, load_laboratory
from bench.report.dcc.schema import CertificateSchema, not_valid
from bench.report.dcc.standards import overdue

__all__ = [
    "DCC",
    "Calibration",
    "CertificateSchema",
    "Laboratory",
    "Span",
    "certificate_text",
    "load_laboratory",
    "nobody",
    "not_valid",
    "overdue",
    "session_of",
]
