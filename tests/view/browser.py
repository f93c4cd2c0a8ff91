"""A Chromium that draws without a screen, and what the tests ask of it."""

from __future__ import annotations

import io
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webelement import WebElement

WIDTH, HEIGHT = 1200, 760

SWITCHES = (
    *("--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--ignore-gpu-blocklist", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    f"--window-size={WIDTH},{HEIGHT}",
    # Whatever a page wants from elsewhere fails, and the console says so.
    "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE localhost , EXCLUDE 127.0.0.1",
)

KNOWN = ("THREE.Clock: This module", "KHR_parallel_shader_compile", "GPU stall due to ReadPixels")
"""What three.js and the software renderer say of themselves."""

CHANGED = 12
"""Difference of grey values by which a pixel counts as another; what is drawn anew is the same."""

REST_S = 2.0
"""A machine with other work draws now and then: what came late must not count as a change."""


class Browser:
    """One Chromium for a whole test run; a page is opened in place of the one before."""

    def __init__(self) -> None:
        chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
        if chromium is None or driver is None:
            raise RuntimeError(
                "these tests need Debian's chromium and chromium-driver: "
                "'tools/system-libraries browser' installs them, make test-all calls it"
            )
        self._profile = tempfile.mkdtemp(prefix="chromium-")
        options = webdriver.ChromeOptions()
        options.binary_location = chromium
        for switch in (*SWITCHES, f"--user-data-dir={self._profile}"):
            options.add_argument(switch)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
        self._said: list[str] = []
        self._driver = webdriver.Chrome(options=options, service=Service(driver))

    def close(self) -> None:
        self._driver.quit()
        shutil.rmtree(self._profile, ignore_errors=True)

    def open(self, page: int | Path) -> None:
        """A page by its port, or from disk; returns when something is drawn and stays."""
        self.leave()
        self._said.clear()
        url = f"http://localhost:{page}" if isinstance(page, int) else page.as_uri()
        # Else the resolution follows how fast it draws, which is in software here.
        self._driver.get(f"{url}?fixedDpr=0.5")
        self.wait(lambda: self._driver.find_elements(By.TAG_NAME, "canvas"), "no canvas")
        self.wait(lambda: (self.picture() < 200).mean() > 0.005, "nothing is drawn")
        # The notice about software rendering lies over the picture.
        notice = ".mantine-Notification-root button"
        for button in self._driver.find_elements(By.CSS_SELECTOR, notice):
            button.click()

    def leave(self) -> None:
        """Leave a page, before its server ends; its complaints are kept."""
        self._hear()
        self._driver.get("about:blank")

    def picture(self) -> np.ndarray:
        """The greys of the middle of the window, where no panel is, (rows, columns)."""
        whole = Image.open(io.BytesIO(self._driver.get_screenshot_as_png())).convert("L")
        grey = np.asarray(whole).astype(int)
        rows, columns = grey.shape
        return grey[rows // 5 : rows * 9 // 10, columns * 2 // 5 : columns * 7 // 10]

    def still(self) -> np.ndarray:
        """The picture when it has not changed for ``REST_S``."""
        before, since = self.picture(), time.monotonic()

        def settled() -> bool:
            nonlocal before, since
            before, last = self.picture(), before
            if different(before, last) > 0:
                since = time.monotonic()
            return time.monotonic() - since >= REST_S

        self.wait(settled, "the picture does not come to rest", 120.0)
        return before

    def changes(self, before: np.ndarray, least: int = 40) -> None:
        """Wait until so many pixels are others."""
        self.wait(lambda: different(self.picture(), before) >= least, "the picture stays as it was")

    def wait(self, done: Callable[[], object], problem: str, timeout_s: float = 60.0) -> None:
        end = time.monotonic() + timeout_s
        while not done():
            assert time.monotonic() < end, problem
            time.sleep(0.2)

    def number(self, label: str, value: float) -> None:
        """Type into the box of a slider or a number."""
        path = f"//*[normalize-space(text())='{label}']/following::input[not(@type='hidden')][1]"
        box = self._driver.find_element(By.XPATH, path)
        box.send_keys(Keys.CONTROL, "a")
        box.send_keys(str(value), Keys.ENTER)

    def choose(self, label: str, option: str) -> None:
        """Choose from a drop-down."""
        path = f"//*[normalize-space(text())='{label}']/following::input[not(@type='hidden')][1]"
        self._driver.find_element(By.XPATH, path).click()
        choice = f"//*[@role='option'][normalize-space(.)='{option}']"

        def offered() -> list[WebElement]:  # those of other drop-downs are there, too, but hidden
            found = self._driver.find_elements(By.XPATH, choice)
            return [element for element in found if element.is_displayed()]

        self.wait(offered, f"no option {option}")
        offered()[0].click()

    def press(self, button: str) -> None:
        self._driver.find_element(By.XPATH, f"//button[normalize-space(.)='{button}']").click()

    def click(self, x: float, y: float) -> None:
        """Click at a share of the window's width and height."""
        actions = webdriver.ActionChains(self._driver)
        canvas = self._driver.find_element(By.TAG_NAME, "body")
        ask = self._driver.execute_script
        width, height = ask("return [window.innerWidth, window.innerHeight]")
        actions.move_to_element_with_offset(
            canvas, round((x - 0.5) * width), round((y - 0.5) * height)
        ).click().perform()

    def text(self) -> str:
        return self._driver.find_element(By.TAG_NAME, "body").text

    def complaints(self) -> list[str]:
        """What the page wrote to the console, but for what is known."""
        self._hear()
        return list(self._said)

    def _hear(self) -> None:
        self._said += [
            entry["message"]
            for entry in self._driver.get_log("browser")
            if entry["level"] in ("WARNING", "SEVERE")
            and not any(known in entry["message"] for known in KNOWN)
        ]


def different(picture: np.ndarray, other: np.ndarray) -> int:
    """How many pixels are others."""
    return int((np.abs(picture - other) > CHANGED).sum())
