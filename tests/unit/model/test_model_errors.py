"""What a technician reads of an error, and the exit status it maps to."""

from __future__ import annotations

import pytest

from bench.model import errors


def test_an_error_says_code_place_message_and_next_step() -> None:
    error = errors.InputError("B-TEST-001", "10 mA is over 1 mA", where="a.yaml:1:2", next_step="lower it")
    assert str(error) == "error B-TEST-001: a.yaml:1:2: 10 mA is over 1 mA. Next: lower it"
    assert str(errors.InputError("B-TEST-001", "wrong")) == "error B-TEST-001: wrong"


def test_several_errors_are_one_line_each_and_carry_the_first() -> None:
    both = errors.InputErrors([errors.InputError("B-TEST-001", "one"), errors.InputError("B-TEST-002", "two")])
    assert str(both).splitlines() == ["error B-TEST-001: one", "error B-TEST-002: two"]
    assert both.code == "B-TEST-001"


@pytest.mark.parametrize(
    ("family", "status"),
    [
        (errors.InputError, 2),
        (errors.FitError, 2),
        (errors.InstrumentError, 3),
        (errors.LinkError, 3),
        (errors.RunError, 3),
        (errors.OperatorStop, 4),
        (errors.SessionDamaged, 5),
        (errors.BenchError, 70),
    ],
)
def test_exit_status_of_each_family(family: type[errors.BenchError], status: int) -> None:
    assert family.exit_status == status
