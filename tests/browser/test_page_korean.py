"""The live page in Korean, in a real browser: by the wish of the browser, on a wide and on a small window, and back."""

from __future__ import annotations

import pytest
from browser_rig import PageServer, visiting
from playwright.sync_api import Browser
from shown_run import ShownRun

pytestmark = pytest.mark.waits

WIDER = "() => document.documentElement.scrollWidth - document.documentElement.clientWidth"
LANGUAGE = "() => document.documentElement.lang"


@pytest.mark.parametrize("width", [1280, 390])
def test_korean_page_keeps_to_the_window(browser: Browser, server: PageServer, shown: ShownRun, width: int) -> None:
    with visiting(browser, server, "viewer", locale="ko-KR", viewport={"width": width, "height": 844}) as visitor:
        page = visitor.open_run(shown.name)
        assert page.evaluate(LANGUAGE) == "ko"
        assert page.inner_text("#badge-word") == "실행 중"
        assert page.evaluate(WIDER) <= 0
        page.goto(server.origin)
        page.wait_for_selector("text=현재 실행")
        assert page.evaluate(WIDER) <= 0
        page.select_option("#language", "en")
        page.wait_for_selector("text=Runs now")
        page.reload()
        assert page.evaluate(LANGUAGE) == "en"
