"""Take a picture of a page as a browser shows it: a race viewer, a replay or a report, for the
documentation.

    python dev/tools/page_picture.py out/mine/view.html docs/images/view.png --link "agent=cfr-argmax&race=96&t=27"

``--link`` is what follows the ``#`` of a page's address. The page is light, whatever the machine
prefers, unless the link says otherwise. Needs Chromium; it is driven as the tests drive it.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))
from browser import Browser, missing


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("page", type=Path)
    parser.add_argument("picture", type=Path, help="a PNG")
    parser.add_argument(
        "--link", default="", help="filters, a race and a moment, as in the page's address"
    )
    parser.add_argument("--width", type=int, default=1440)
    parser.add_argument("--height", type=int, default=900)
    given = parser.parse_args()
    if missing() or not given.page.is_file():
        parser.error(missing() or f"there is no {given.page}")
    link = given.link if "theme=" in given.link else f"{given.link}&theme=light".lstrip("&")
    browser, before = Browser(), np.zeros(0)
    try:
        browser.open(f"{given.page.resolve().as_uri()}#{link}", given.width, given.height)
        # What a frame draws is seen a little later: wait for two pictures in a row that are the
        # same.
        while not np.array_equal(before, pixels := browser.screenshot()):
            before = pixels
            time.sleep(1.0)
        if browser.complaints:
            raise SystemExit(f"the page complains: {browser.complaints[0]}")
    finally:
        browser.close()
    picture = Image.fromarray(pixels.astype(np.uint8)).quantize(256, dither=Image.Dither.NONE)
    picture.save(given.picture, optimize=True)
    print(
        f"{given.picture}: {given.width} x {given.height},"
        f" {given.picture.stat().st_size / 1e3:.0f} kB"
    )


if __name__ == "__main__":
    main()
