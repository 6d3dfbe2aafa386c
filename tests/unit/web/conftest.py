"""One page server for the tests of a file."""

from collections.abc import Iterator

import pytest
from web_rig import Page, served


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with served(tmp_path_factory.mktemp("page")) as found:
        yield found


@pytest.fixture
def page(server: Page) -> Page:
    """The server as if nobody had been there."""
    server.forget()
    return server
