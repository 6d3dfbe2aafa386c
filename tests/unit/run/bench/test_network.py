"""Addresses on the network: which host and port they mean, and that a silent one is found at once."""

from __future__ import annotations

import socket

import pytest

from bench.run.bench.network import check_answers, port_of


@pytest.mark.parametrize(
    ("resource", "found"),
    [
        ("TCPIP0::127.0.0.1::hislip3,41234::INSTR", ("127.0.0.1", 41234)),
        ("TCPIP::meter.lab::hislip0::INSTR", ("meter.lab", 4880)),
        ("TCPIP0::10.0.0.7::inst0::INSTR", ("10.0.0.7", 111)),
        ("TCPIP0::10.0.0.7::5025::SOCKET", ("10.0.0.7", 5025)),
        ("GPIB0::4::INSTR", None),
        ("ASRL/dev/ttyS0::INSTR", None),
    ],
)
def test_host_and_port(resource: str, found: tuple[str, int] | None) -> None:
    assert port_of(resource) == found


def test_somebody_answers_or_not() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        check_answers(f"TCPIP0::127.0.0.1::{port}::SOCKET")
    with pytest.raises(OSError, match=r"refused|timed out"):
        check_answers(f"TCPIP0::127.0.0.1::{port}::SOCKET")
    check_answers("GPIB0::4::INSTR")
