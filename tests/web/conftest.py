"""Chromium without a window, in which the tests of the page open it; they are skipped where there is none."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

# Without a graphics card: Chromium then computes the pictures itself.
_FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]

_OWN = ("file:", "data:", "blob:", "about:")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A running browser."""
    path = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if path is None:
        pytest.skip("needs Chromium (chromium), which is not installed")
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright, which is not installed")
    with playwright.sync_playwright() as driver:
        running = driver.chromium.launch(executable_path=path, args=_FLAGS)
        yield running
        running.close()


@pytest.fixture
def opened(browser: Any) -> Iterator[Callable[..., Any]]:
    """Open a file and return the page once it is ready; in the end no page may have logged or thrown anything."""
    said: list[str] = []
    contexts = []

    def open_page(path: Any, width: int = 1000, height: int = 700, **options: Any) -> Any:
        context = browser.new_context(viewport={"width": width, "height": height}, **options)
        contexts.append(context)
        page = context.new_page()
        # A driver's remark on its own speed is none of the page's.
        page.on("console", lambda message: said.extend([] if "GL Driver" in message.text else [message.text]))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: said.extend([] if request.url.startswith(_OWN) else [request.url]))
        page.goto(f"file://{path}")
        until(page, "document.documentElement.dataset.state === 'ready'")
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert said == []


def until(page: Any, expression: str, seconds: float = 60.0) -> None:
    """Wait until an expression is true. The page's policy lets nothing evaluate text within it, so it is asked."""
    end = time.monotonic() + seconds
    while not page.evaluate(expression):
        assert time.monotonic() < end, f"still not: {expression}"
        page.wait_for_timeout(15)
