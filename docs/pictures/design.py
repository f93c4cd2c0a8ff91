"""Draw docs/images/design.png and design_proposal.png: ``twinct design`` in Chromium."""

from __future__ import annotations

import sys
import tempfile
from contextlib import closing
from pathlib import Path

import trimesh

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests" / "support"))
from browser import Browser  # noqa: E402

from twinct.design.draft import open_draft  # noqa: E402
from twinct.design.page import DesignPage  # noqa: E402
from twinct.viewer.server import LOOPBACK, close, serve  # noqa: E402

IMAGES = ROOT / "docs" / "images"
VIEW = 70
AWAY_MM = (1000, 0, -150)
"""Base of the source's arm from which some views are out of reach."""


def main() -> None:
    """Draw the pictures."""
    server = serve(LOOPBACK, 0, files=True)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        draft = open_draft(Path("demo"), folder)
        with closing(DesignPage(server, draft, folder)) as page, closing(Browser()) as browser:

            def says(text: str) -> None:
                browser.wait(lambda: text in browser.text(), f"the page does not say {text!r}")

            browser.open(page.page)
            page.settle()
            browser.choose("body", "source arm")
            browser.number("views", 60)
            browser.turn_to("Image")
            browser.number("view", VIEW % 60)
            says("all pixels")
            page.settle()
            browser.screenshot(IMAGES / "design.png")

            part = trimesh.creation.annulus(r_min=20, r_max=40, height=60)
            part.export(folder / "my part.stl")
            browser.open_folder("Choose")
            browser.upload(folder / "my part.stl")
            says("80.0 x 80.0 x 60.0 mm")
            browser.open_folder("Choose")
            browser.type_numbers("position, mm", AWAY_MM)
            says("out of reach")
            browser.press("place arms")
            says("proposed")
            page.settle()
            browser.screenshot(IMAGES / "design_proposal.png")
            browser.leave()
    close(server)


if __name__ == "__main__":
    main()
