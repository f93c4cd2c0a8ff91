"""The documentation site: strict, whole, and usable in a browser."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any
from urllib.parse import quote

import pytest
from browser import Browser
from waiting import until

ROOT = Path(__file__).parents[2]


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        """Requests are of no interest."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site from a copy of the pages, without running the tutorials, which take minutes."""
    folder = tmp_path_factory.mktemp("site")
    left_out = shutil.ignore_patterns("tutorials", "gallery", "__pycache__", "sg_*")
    shutil.copytree(ROOT / "docs", folder / "docs", ignore=left_out)
    shutil.copytree(ROOT / "examples", folder / "examples")
    shutil.copy(ROOT / "CHANGELOG.md", folder)  # links in it are read from where it lies
    for name in ("benchmarks", "pyproject.toml", "scenarios", "src", "tests"):
        (folder / name).symlink_to(ROOT / name)
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "docs", "site"]
    execute = os.environ | {"TWINCT_DOCS_EXECUTE": "0"}
    made = subprocess.run(command, cwd=folder, env=execute, capture_output=True, text=True)
    assert made.returncode == 0, made.stderr
    return folder / "site"


@pytest.fixture(scope="module")
def address(site: Path) -> Iterator[str]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(site)))
    serving = Thread(target=server.serve_forever, daemon=True)
    serving.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()
    serving.join()


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with closing(Browser()) as made:
        yield made


@pytest.mark.browser
@pytest.mark.process
def test_the_site_leads_from_page_to_page(browser: Browser, address: str) -> None:
    browser.visit(address)

    def links() -> list[Any]:
        found = browser.find(".navbar-header-items__start ~ * a.nav-link, .navbar-nav a.nav-link")
        return [link for link in found if link.is_displayed()]

    names = ["Start", "Tutorials", "Gallery", "How-to", "Explanation", "Reference"]
    until(lambda: [link.text for link in links()][:6] == names, "the pages' names do not show")
    next(link for link in links() if link.text == "Reference").click()
    until(lambda: "Look things up here" in browser.text(), "the reference does not open")
    assert browser.complaints() == []


@pytest.mark.browser
@pytest.mark.process
def test_the_search_finds_a_key(browser: Browser, address: str) -> None:
    browser.visit(f"{address}/search.html?q=photons_per_mm2_mas")

    def found() -> bool:
        return any("Scenario reference" in link.text for link in browser.find("ul.search a"))

    until(found, "the search does not find a key of the scenario")
    assert browser.complaints() == []


SEARCHES = {
    "believed": "explanation/geometry",
    "double edges": "howto/symptoms",
    "ghost": "howto/symptoms",
    "PACS": "howto/open_volume",
    "rail": "arms",
    "STL": "howto/own_stl",
    "dose": "transport",
    "metal": "metal",
    "CT patient": "howto/ct_as_specimen",
    "how long run takes": "howto/faster",
    "projection matrices": "howto/open_volume",
    "noise off": "howto/noise",
    "Windows": "start/install",
    "own robot": "arm_files",
    "how do I pick the voxel size": "howto/grid",
    "scan is mirrored": "howto/symptoms",
    "run on a GPU": "howto/faster",
    "out of memory": "howto/errors",
    "center of rotation is wrong": "calibration",
    "kilovolt and filter of the tube": "howto/noise",
    "flat field correction": "measured",
    "SLURM job array": "howto/study",
    "Jupyter notebook": "start/python",
    "collision with the table": "reach",
    "respiratory motion": "howto/ct_as_specimen",
    "sparse view reconstruction": "howto/which_algorithm",
    "field of view too small": "howto/truncation",
    "neural network gradients": "howto/own_algorithm",
    "anti-scatter grid": "howto/scatter",
    "modulation transfer function": "figures",
    "my volume is blurry": "howto/symptoms",
    "spiral trajectory": "trajectories",
    "rosbag recording": "recording",
    "Hounsfield units": "howto/open_volume",
}
"""Words that a new user types, and the page that answers."""


@pytest.mark.browser
@pytest.mark.process
@pytest.mark.parametrize(("words", "page"), SEARCHES.items(), ids=SEARCHES)
def test_the_search_shows_the_answer_early(
    browser: Browser, address: str, words: str, page: str
) -> None:
    browser.visit(f"{address}/search.html?q={quote(words)}")

    def shown() -> bool:
        links = browser.find("ul.search > li > a")
        return any(f"/{page}.html" in str(link.get_attribute("href")) for link in links[:3])

    until(shown, f"{page} is not among the first three results")
    assert browser.complaints() == []


@pytest.mark.browser
@pytest.mark.process
def test_a_page_of_the_gallery_opens_and_its_program_can_be_taken(
    browser: Browser, address: str
) -> None:
    browser.visit(f"{address}/gallery/index.html")
    programs = list((ROOT / "examples" / "gallery").glob("*.py"))

    def pages() -> list[str]:
        cards = browser.find(".sphx-glr-thumbcontainer a")
        return sorted({str(card.get_attribute("href")) for card in cards})

    until(lambda: len(pages()) == len(programs), "the gallery does not show each program once")
    browser.visit(pages()[0])
    until(lambda: browser.find(".sphx-glr-download-python a"), "no program can be taken")
    assert browser.complaints() == []


@pytest.mark.browser
@pytest.mark.process
def test_the_site_has_a_dark_mode_and_a_version_switch(browser: Browser, address: str) -> None:
    browser.visit(f"{address}/reference/commands.html")
    browser.script("document.documentElement.dataset.mode = 'light'")
    browser.script("document.querySelector('[data-mode-target], .theme-switch-button').click()")
    until(lambda: browser.find(".version-switcher__menu a[href]"), "no versions are listed")
    versions = json.loads((ROOT / "docs/site/root/switcher.json").read_text(encoding="utf-8"))
    told = browser.script("return document.querySelector('.version-switcher__button').innerText")
    assert told.strip() == versions[0]["name"]
    assert browser.complaints() == []
