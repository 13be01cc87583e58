"""HTML pages as parsed by a browser: nesting, addresses, images."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import threading
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

VOID = {"meta", "img", "br", "link", "input", "hr"}


class Page(HTMLParser):
    """Parser that checks the nesting of elements and collects addresses and ids."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.counts: dict[str, int] = {}
        self.ids: list[str] = []
        self.elements: list[tuple[str, dict[str, str]]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.counts[tag] = self.counts.get(tag, 0) + 1
        self.elements.append((tag, {name: value or "" for name, value in attrs}))
        for name, value in attrs:
            if name in ("href", "src", "srcset", "xlink:href", "action", "data", "poster"):
                self.addresses.append(value or "")
            if name == "id":
                self.ids.append(value or "")
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open, tag
        assert self.open[-1] == tag, (self.open, tag)
        self.open.pop()


def parsed(html: str) -> Page:
    page = Page()
    page.feed(html)
    page.close()
    assert page.open == []
    return page


in_browser = pytest.mark.skipif(
    shutil.which("chromium") is None, reason="no Chromium: the page's scripts are not run"
)


def decoded(address: str) -> np.ndarray:
    content = base64.b64decode(address.removeprefix("data:image/png;base64,"))
    return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)


_MEASURE = """<script>addEventListener('load', () => {
  const shown = [...document.querySelectorAll('body *')].filter(one => one.checkVisibility() &&
    [...one.childNodes].some(node => node.nodeType === 3 && node.textContent.trim()));
  const scale = ({b, d}) => Math.hypot(b, d);
  const height = one =>
    parseFloat(getComputedStyle(one).fontSize) * (one.getScreenCTM ? scale(one.getScreenCTM()) : 1);
  const other = ['title', 'SCRIPT', 'STYLE', 'OPTION', 'NOSCRIPT'];
  const small = shown.filter(one => !other.includes(one.nodeName))
    .map(one => [height(one), one.nodeName, one.textContent.trim().slice(0, 30)]).sort((a, b) => a[0] - b[0]);
  const wide = document.documentElement.scrollWidth - document.documentElement.clientWidth;
  console.log('measured ' + JSON.stringify({texts: small.length, wide, smallest: small.slice(0, 5)}));
});</script>"""


def measured(html: str, width: int, folder: Path) -> dict[str, Any]:
    """What Chromium shows of a page ``width`` pixels wide: ``texts``, their number; ``smallest``, the
    five smallest of them (height in pixels, element, text); ``wide``, pixels by which the page is
    wider than the window.
    """
    inner, outer = folder / f"inner-{width}.html", folder / f"outer-{width}.html"
    inner.write_text(html.replace("</body>", f"{_MEASURE}</body>"), "utf-8")
    size = f"width:{width}px;height:3000px;border:0"
    outer.write_text(f"<iframe src='{inner.name}' style='{size}'></iframe>")
    line = logged(outer, "measured", folder / f"browser-{width}")
    found: dict[str, Any] = json.loads(line[line.index("{") : line.rindex("}") + 1])
    return found


def beyond_paper(html: str, folder: Path) -> float:
    """Pixels of a page that are not printed: A4 with margins of 1 cm is 718 wide."""
    printed = html.replace("@media print", "@media all")
    assert printed != html
    return float(measured(printed, 718, folder)["wide"])


def logged(page: Path, word: str, folder: Path) -> str:
    """The line with the word that the page's scripts log, in Chromium; empty if none comes in two minutes."""
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr"]
    command = ["chromium", *options, "--remote-debugging-port=0", f"--user-data-dir={folder}"]
    with subprocess.Popen([*command, page.as_uri()], stderr=subprocess.PIPE, text=True) as browser:
        assert browser.stderr is not None
        late = threading.Timer(120.0, browser.kill)
        late.start()
        found = next((line for line in browser.stderr if f'"{word} ' in line), "")
        late.cancel()
        browser.kill()
    return found
