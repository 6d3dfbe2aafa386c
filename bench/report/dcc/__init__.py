"""Digital Calibration Certificates: PTB DCC 3.2.1 with D-SI units."""

from bench.report.dcc.calibration import Calibration, Laboratory, Span, load_laboratory, nobody
from bench.report.dcc.certificate import certificate_text, session_of
from bench.report.dcc.elements import DCC
from bench.report.dcc.measurement import overdue
from bench.report.dcc.schema import CertificateSchema, not_valid

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
