"""Draw docs/images/design.png: the page of ``twinct design`` in Chromium."""

from __future__ import annotations

import sys
import tempfile
from contextlib import closing
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests" / "support"))
from browser import Browser  # noqa: E402

from twinct.design.draft import open_draft  # noqa: E402
from twinct.design.page import DesignPage  # noqa: E402
from twinct.viewer.server import LOOPBACK, close, serve  # noqa: E402

VIEW = 70


def main() -> None:
    """Draw the picture."""
    server = serve(LOOPBACK, 0)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        draft = open_draft(Path("demo"), folder)
        with closing(DesignPage(server, draft, folder)) as page, closing(Browser()) as browser:
            browser.open(page.page)
            page.settle()
            browser.choose("body", "source arm")
            browser.number("views", 60)
            browser.turn_to("Image")
            browser.number("view", VIEW % 60)
            browser.wait(lambda: "all pixels" in browser.text(), "no image with all pixels")
            page.settle()
            browser.still()
            browser.screenshot(ROOT / "docs" / "images" / "design.png")
            browser.leave()
    close(server)


if __name__ == "__main__":
    main()
