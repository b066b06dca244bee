"""A page in the system's Chromium without a display, driven by playwright."""

import io
import shutil
import time
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from PIL import Image

PATIENCE = 90.0  # seconds; other work may keep the machine busy
PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
# Nothing is fetched from a network, which may be closed.
OPTIONS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


def missing():
    """Return the missing part of a browser, in words; empty if a page can be opened."""
    for library in ("playwright", "axe_playwright_python"):
        if find_spec(library) is None:
            return f'{library} is not installed: pip install ".[test]"'
    return (
        "" if chromium() else f"no Chromium on PATH to open the page with ({', '.join(PROGRAMS)})"
    )


def chromium():
    """The program, or None."""
    return next(filter(None, map(shutil.which, PROGRAMS)), None)


class Browser:
    """One page. ``complaints`` holds the warnings and errors on its console since it was opened,
    frames included.
    """

    def __init__(self):
        from playwright.sync_api import sync_playwright

        self._playwright = sync_playwright().start()
        self._chromium = self._playwright.chromium.launch(executable_path=chromium(), args=OPTIONS)
        self.page = self._chromium.new_page()
        self.page.set_default_timeout(1000.0 * PATIENCE)
        self.said, self.complaints = [], []
        self.page.on("console", self._hear)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))

    def _hear(self, message):
        self.said.append(message.text)
        if message.type in ("error", "warning"):
            self.complaints.append(message.text)

    def show(self, width, height, scheme="light", motion="no-preference"):
        self.page.set_viewport_size({"width": width, "height": height})
        self.page.emulate_media(media="screen", color_scheme=scheme, reduced_motion=motion)

    def open(self, address, width=1280, height=720, **media):
        self.show(width, height, **media)
        # or an address that differs in its link alone would not be loaded again
        self.page.goto("about:blank")
        self.said.clear()
        self.complaints.clear()
        self.page.goto(address if "://" in str(address) else Path(address).as_uri())
        # A page with packed numbers unpacks them after it has loaded.
        self.page.evaluate("typeof started === 'undefined' || started")

    def run(self, expression):
        return self.page.evaluate(expression)

    def wait(self, expression, frame=0):
        return self._until(
            lambda: self.page.frames[frame].evaluate(expression), bool, f"{expression} stays false"
        )

    def _until(self, value, right, complaint):
        # Not by playwright's own waiting: it evaluates texts inside the page, which the pages'
        # policy forbids.
        end = time.monotonic() + PATIENCE
        while not right(found := value()):
            assert time.monotonic() < end, complaint
            time.sleep(0.1)
        return found

    def hindrances(self):
        """Serious and critical findings of axe-core in the page and its first frame: the rule, and
        the first element.
        """
        found = []
        for frame in self.page.frames[:2]:
            if not frame.evaluate("'axe' in window"):
                frame.evaluate(
                    files("axe_playwright_python")
                    .joinpath("axe.min.js")
                    .read_text(encoding="utf-8")
                )
            told = frame.evaluate(
                "axe.run(document, { resultTypes: ['violations'], iframes: false })"
            )
            serious = [
                one for one in told["violations"] if one["impact"] in ("serious", "critical")
            ]
            found += [(one["id"], one["nodes"][0]["html"]) for one in serious]
        return found

    def press(self, key):
        self.page.keyboard.press(key)

    def screenshot(self):
        """Pixels, shape (height, width, 3)."""
        return np.array(Image.open(io.BytesIO(self.page.screenshot())).convert("RGB")).astype(int)

    def look(self, right):
        """Look until a picture is right: a drawn frame reaches the screen a little later."""
        return self._until(self.screenshot, right, "the page never looks right")

    def close(self):
        self._chromium.close()
        self._playwright.stop()
