"""Digital Calibration Certificates: PTB DCC 3.2.1 with D-SI units."""

from bench.report.dcc.calibration import Calibration, Span, nobody
from bench.report.dcc.certificate import CERTIFICATE_FILE, SPECIMEN_FILE, certificate_text, session_of
from bench.report.dcc.elements import DCC
from bench.report.dcc.measurement import method_of, overdue
from bench.report.dcc.schema import CertificateSchema, not_valid

__all__ = [
    "CERTIFICATE_FILE",
    "DCC",
    "SPECIMEN_FILE",
    "Calibration",
    "CertificateSchema",
    "Span",
    "certificate_text",
    "method_of",
    "nobody",
    "not_valid",
    "overdue",
    "session_of",
]
