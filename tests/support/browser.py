"""A Chromium that draws without a screen, and what the tests ask of it."""

from __future__ import annotations

import io
import itertools
import os
import shutil
import signal
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import viser
from PIL import Image
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webelement import WebElement
from waiting import HANG_S, Patience, until

from twinct.viewer.live_page import Page
from twinct.viewer.server import address

WIDTH, HEIGHT = 1200, 760

SWITCHES = (
    *("--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--ignore-gpu-blocklist", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    f"--window-size={WIDTH},{HEIGHT}",
    # Whatever a page wants from elsewhere fails, and the console says so.
    "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE localhost , EXCLUDE 127.0.0.1",
)

KNOWN = (
    *("THREE.Clock: This module", "KHR_parallel_shader_compile", "GPU stall due to ReadPixels"),
    "Tried to update non-existent component",
)
"""Messages that name no fault of the page.

The first three come from three.js and the software renderer. The last comes from viser's client: it
applies the updates of one animation frame after the frame's removals, so a control that is updated
and then removed within a slow frame is missing. viser's server refuses updates after a removal.
"""

CHANGED = 12
"""Difference of grey values by which a pixel counts as another; what is drawn anew is the same."""

ALIKE = 3
"""Pictures in a row that are the same when a page is at rest."""

BEFORE_ANY_PAGE = """
    window.decoding = 0;
    const image = HTMLImageElement.prototype;
    const source = Object.getOwnPropertyDescriptor(image, "src");
    Object.defineProperty(image, "src", {...source, set(value) {
        window.decoding += 1;
        let over = false;
        const end = () => { window.decoding -= over ? 0 : 1; over = true; };
        this.addEventListener("load", end, {once: true});
        this.addEventListener("error", end, {once: true});
        source.set.call(this, value);
    }});
    if (location.protocol === "file:") {
        let now = 0;
        Date.now = () => now;
        window.passTime = (ms) => { now += ms; };
    }
"""
"""Counts the images that are being decoded. The clock by which a page from disk plays only goes on
when ``passTime`` is called."""

DRAWN = """
    const [all, done] = arguments;
    const page = window.__viserMutable;
    let left = 4;
    const frame = () => {
        if (all && (page.messageQueue.length > 0 || window.decoding > 0)) left = 4;
        left -= 1;
        page.requestRender();
        if (left > 0) requestAnimationFrame(frame); else done();
    };
    frame();
"""
"""Return when the page has drawn several times: with ``all``, everything that it has received and
its images, to which a page that plays may never come on a slow machine."""

PASS_TIME = """
    const [ms, done] = arguments;
    window.passTime(ms);
    setTimeout(done, 20);  // comes after the timer by which the page plays, which is shorter
"""

ASK = """
    const [page, protocol, done] = arguments;
    const asking = new WebSocket(page, [protocol]);
    asking.onmessage = () => done(true);
    asking.onclose = () => done(false);
"""
PROTOCOL = f"viser-v{viser.__version__}"

_MARKS = itertools.count()


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
        self._page: Page | None = None
        self._driver = webdriver.Chrome(options=options, service=Service(driver))
        self._driver.set_script_timeout(HANG_S)
        self._driver.execute_cdp_cmd(
            "Page.addScriptToEvaluateOnNewDocument", {"source": BEFORE_ANY_PAGE}
        )

    def close(self) -> None:
        self._driver.quit()
        shutil.rmtree(self._profile, ignore_errors=True)

    def kill(self) -> None:
        """Kill all processes of Chromium, as the kernel does when memory runs out."""
        for process in Path("/proc").glob("[0-9]*"):
            with suppress(OSError):  # some end meanwhile
                if self._profile.encode() in (process / "cmdline").read_bytes():
                    os.kill(int(process.name), signal.SIGKILL)
        self._driver.service.stop()
        shutil.rmtree(self._profile, ignore_errors=True)

    def open(self, page: Page | str | Path) -> None:
        """Open a page, one of another process by its address, or one from disk; see it drawn."""
        self.leave()
        self._said.clear()
        self._page = page if isinstance(page, Page) else None
        where = address(page.server) if isinstance(page, Page) else page
        url = where.as_uri() if isinstance(where, Path) else where
        # Else the resolution follows how fast it draws, which is in software here.
        self._driver.get(f"{url}?fixedDpr=0.5")
        self.wait(lambda: self._driver.find_elements(By.TAG_NAME, "canvas"), "no canvas")
        self.wait(lambda: (self.picture() < 200).mean() > 0.005, "nothing is drawn")
        # The notice about software rendering lies over the picture.
        notice = ".mantine-Notification-root button"
        for button in self._driver.find_elements(By.CSS_SELECTOR, notice):
            button.click()

    def visit(self, url: str) -> None:
        """Open a page that draws nothing, in place of the one before."""
        self.leave()
        self._said.clear()
        self._driver.get(url)

    def find(self, css: str) -> list[WebElement]:
        """The elements of the page that a selector names."""
        return self._driver.find_elements(By.CSS_SELECTOR, css)

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
        """The picture when the page has drawn all that it was asked to show."""
        if self._page is not None:
            assert self._page.settle(HANG_S)
            self._page.server.scene.add_frame(mark := f"/mark{next(_MARKS)}", show_axes=False)
            self.wait(lambda: self._has(mark), "the page does not hear")
        alike, last, patience = 1, self.drawn(), Patience()
        while alike < ALIKE:
            patience.check("a picture that rests")
            before, last = last, self.drawn()
            alike = alike + 1 if different(last, before) == 0 else 1
        return last

    def _has(self, node: str) -> bool:
        told = "return arguments[0] in window.__viserSceneTree.getState()"
        return self._driver.execute_script(told, node)

    def drawn(self, *, all_received: bool = True) -> np.ndarray:
        """Return the picture of everything that the page has received by now, or of a part."""
        self._driver.execute_async_script(DRAWN, all_received)
        return self.picture()

    def changes(self, before: np.ndarray, least: int = 40) -> None:
        """Wait until so many pixels are others, of a page that may be playing."""

        def changed() -> bool:
            return different(self.drawn(all_received=False), before) >= least

        self.wait(changed, "the picture stays as it was")

    def wait(self, done: Callable[[], object], problem: str) -> None:
        until(done, problem)

    def pass_time(self, seconds: float) -> None:
        """Let the clock of a page from disk go on, and let it be seen there."""
        self._driver.execute_async_script(PASS_TIME, 1000 * seconds)

    def number(self, label: str, value: float) -> None:
        """Type into the box of a slider or a number."""
        path = f"//*[normalize-space(text())='{label}']/following::input[not(@type='hidden')][1]"
        box = self._driver.find_element(By.XPATH, path)
        box.send_keys(Keys.CONTROL, "a")
        box.send_keys(str(value), Keys.ENTER)
        self._arrives(label, value)

    def type_numbers(self, label: str, values: Sequence[float]) -> None:
        """Type into the boxes of a vector."""
        path = f"//*[normalize-space(text())='{label}']/following::input[not(@type='hidden')]"
        self.wait(lambda: self._driver.find_elements(By.XPATH, path), f"no boxes of {label}")
        for k, value in enumerate(values):
            box = self._driver.find_elements(By.XPATH, path)[k]
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
        self._arrives(label, option)

    def _arrives(self, label: str, value: Any) -> None:
        """Wait until the page knows what was set."""
        assert self._page is not None
        handles = self._page.server.gui._gui_input_handle_from_uuid.values()
        handle = next(h for h in handles if getattr(h, "label", None) == label)
        self.wait(lambda: handle.value == value, f"{label} does not become {value}")

    def open_folder(self, name: str) -> None:
        """Open or close a folder of controls."""
        path = f"//*[normalize-space(text())='{name}']"
        found = [one for one in self._driver.find_elements(By.XPATH, path) if one.is_displayed()]
        found[-1].click()

    def upload(self, path: Path) -> None:
        """Give a file to the page's upload button."""
        (box,) = self._driver.find_elements(By.CSS_SELECTOR, "input[type=file]")
        box.send_keys(str(path))

    def press(self, button: str) -> None:
        self.button(button).click()

    def button(self, name: str) -> WebElement:
        """Return a button."""
        return self._driver.find_element(By.XPATH, f"//button[normalize-space(.)='{name}']")

    def turn_to(self, tab: str) -> None:
        path = f"//*[@role='tab'][normalize-space(.)='{tab}']"
        self._driver.find_element(By.XPATH, path).click()

    def click(self, x: float, y: float) -> None:
        """Click at a share of the window's width and height."""
        actions = webdriver.ActionChains(self._driver)
        canvas = self._driver.find_element(By.TAG_NAME, "body")
        ask = self._driver.execute_script
        width, height = ask("return [window.innerWidth, window.innerHeight]")
        actions.move_to_element_with_offset(
            canvas, round((x - 0.5) * width), round((y - 0.5) * height)
        ).click().perform()

    def script(self, code: str, *told: Any) -> Any:
        """What a script in the page returns."""
        return self._driver.execute_script(code, *told)

    def comes(self, page: str, asking: str) -> bool:
        """Whether a page's data come to a script that asks from another page's address."""
        self.leave()
        self._driver.get(asking)
        return self._driver.execute_async_script(ASK, page.replace("http", "ws", 1), PROTOCOL)

    def screenshot(self, path: Path) -> None:
        """Write the whole window to a PNG file."""
        path.write_bytes(self._driver.get_screenshot_as_png())

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
