"""Take a picture of a page as a browser shows it: a race viewer, a replay or a report, for the documentation.

    python tools/page_picture.py out/mine/view.html docs/images/view.png --link "agent=cfr-argmax&race=96&t=27"

``--link`` is what follows the ``#`` of a page's address. The page is light, whatever the machine prefers, unless the
link says otherwise. Needs Chromium; it is driven as the tests drive it.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests/pcs_racing_agents/view"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("page", type=Path)
    parser.add_argument("picture", type=Path, help="a PNG")
    parser.add_argument("--link", default="", help="filters, a race and a moment, as in the page's address")
    parser.add_argument("--width", type=int, default=1440)
    parser.add_argument("--height", type=int, default=900)
    given = parser.parse_args()
    if not given.page.is_file():
        parser.error(f"there is no {given.page}")
    from chromium_pipe import Browser, chromium  # type: ignore[import-not-found]
    from PIL import Image

    if chromium() is None:
        parser.error("there is no chromium on PATH to open the page with")
    link = given.link if "theme=" in given.link else f"{given.link}&theme=light".lstrip("&")
    with tempfile.TemporaryDirectory() as profile:
        browser: Any = Browser(profile)
        try:
            browser.open(f"{given.page.resolve().as_uri()}#{link}", given.width, given.height)
            pixels = still(browser)
            if browser.complaints:
                raise SystemExit(f"the page complains: {browser.complaints[0]}")
        finally:
            browser.close()
    picture = Image.fromarray(pixels.astype(np.uint8)).quantize(256, dither=Image.Dither.NONE)
    picture.save(given.picture, optimize=True)
    print(f"{given.picture}: {given.width} x {given.height}, {given.picture.stat().st_size / 1e3:.0f} kB")


def still(browser: Any) -> np.ndarray:
    """Look until two pictures in a row, a second apart, are the same: what a frame draws is seen a little later."""
    before = browser.screenshot()
    for _ in range(60):
        time.sleep(1.0)
        after: np.ndarray = browser.screenshot()
        if np.array_equal(before, after):
            return after
        before = after
    raise SystemExit("the page never stands still; name a moment (t=...) and no play in --link")


if __name__ == "__main__":
    main()
