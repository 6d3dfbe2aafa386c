"""A package of an extra that is missing is one line; any other missing module is a fault of the bench."""

from __future__ import annotations

import pytest

from bench.model.errors import ExitStatus, InputError
from bench.model.extras import extras_named


def test_a_package_of_an_extra_is_named_with_it() -> None:
    with (
        pytest.raises(InputError, match=r"the live page needs bokeh, which is not installed") as caught,
        extras_named(),
    ):
        raise ModuleNotFoundError("No module named 'bokeh.plotting'", name="bokeh.plotting")
    assert caught.value.code == "B-PKG-005"
    assert caught.value.exit_status == ExitStatus.BAD_INPUT
    assert caught.value.next_step == "pip install 'inertial-bench[page]'"


def test_any_other_module_that_is_missing_stays_what_it_is() -> None:
    with pytest.raises(ModuleNotFoundError, match="no_such_module"), extras_named():
        import no_such_module  # noqa: F401
