"""A Chromium without a window, and a report in it."""

from __future__ import annotations

import os
import shutil
import time
from pathlib import Path
from typing import Any

import pytest

BINARY = (
    os.environ.get("SPLITKNIT_CHROMIUM")
    or shutil.which("chromium")
    or shutil.which("chromium-browser")
)
DRIVER = os.environ.get("SPLITKNIT_CHROMEDRIVER") or shutil.which("chromedriver")
PATIENCE_S = 90.0
PICTURES = Path(
    os.environ.get(
        "SPLITKNIT_PICTURES", Path(__file__).resolve().parents[3] / "tests" / "out" / "page"
    )
)


def why_not() -> str:
    """Return why no browser can be used here, or nothing."""
    try:
        import selenium  # noqa: F401
    except ImportError:
        return "needs the dependency group browser: pip install --group browser"
    if BINARY is None or DRIVER is None:
        return "needs Chromium and its driver (Debian: chromium, chromium-driver)"
    return ""


class Page:
    """A page, as a person and as a program see it."""

    def __init__(
        self, width: int = 1280, height: int = 800, *flags: str, still: bool = False
    ) -> None:
        """Start a browser whose page has so many CSS pixels."""
        from selenium import webdriver
        from selenium.webdriver.chrome.service import Service

        options = webdriver.ChromeOptions()
        options.binary_location = str(BINARY)
        for flag in (
            "--headless=new",
            "--no-sandbox",
            "--disable-dev-shm-usage",
            "--disable-background-networking",
            "--no-first-run",
            "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader",
            "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
            *flags,
        ):
            options.add_argument(flag)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
        self.driver = webdriver.Chrome(options=options, service=Service(str(DRIVER)))
        self.driver.set_page_load_timeout(PATIENCE_S)
        self.driver.set_script_timeout(PATIENCE_S)
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        if still:
            motion = [{"name": "prefers-reduced-motion", "value": "reduce"}]
            self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": motion})

    def run(self, script: str, *arguments: Any) -> Any:
        """Run a script in the page."""
        return self.driver.execute_script(script, *arguments)

    def wait(self, script: str, what: str = "") -> Any:
        """Wait until a script returns something true, and return that."""
        end = time.monotonic() + PATIENCE_S
        while True:
            value = self.run(script)
            if value:
                return value
            if time.monotonic() > end:
                words = self.run("return document.body.innerText")[:400]
                pytest.fail(
                    f"waited {PATIENCE_S:.0f} s for {what or script}; the page says {words!r}"
                )
            time.sleep(0.05)

    def open(self, url: str) -> None:
        """Open an address and wait for the finger, where one is shown."""
        self.driver.get(url)
        self.drawn()

    def drawn(self) -> None:
        """Wait until the surface is drawn."""
        self.wait("return document.body.dataset.state === 'ready'", "the finger")

    def find(self, selector: str) -> Any:
        """Return an element."""
        return self.driver.find_element("css selector", selector)

    def slide(self, selector: str, value: float) -> None:
        """Move a slider."""
        self.run(
            "arguments[0].value = arguments[1];"
            "arguments[0].dispatchEvent(new Event('input', {bubbles: true}))",
            self.find(selector),
            value,
        )

    def press(self, *keys: str) -> None:
        """Press keys where the focus is."""
        from selenium.webdriver.common.action_chains import ActionChains

        for key in keys:
            ActionChains(self.driver).send_keys(key).perform()

    def move_over(self, selector: str, right: int, down: int) -> None:
        """Move the pointer to a place relative to an element's middle."""
        from selenium.webdriver.common.action_chains import ActionChains

        ActionChains(self.driver).move_to_element_with_offset(
            self.find(selector), right, down
        ).perform()

    def click_at(self, selector: str, right: int, down: int) -> None:
        """Click a place relative to an element's middle."""
        from selenium.webdriver.common.action_chains import ActionChains

        ActionChains(self.driver).move_to_element_with_offset(
            self.find(selector), right, down
        ).click().perform()

    def picture(self, name: str) -> Path:
        """Keep what is seen."""
        PICTURES.mkdir(parents=True, exist_ok=True)
        from selenium.common.exceptions import TimeoutException

        for attempt in range(6):
            try:
                self.driver.save_screenshot(str(PICTURES / f"{name}.png"))
                break
            # the driver waits ten seconds for a frame; a busy machine takes longer
            except TimeoutException:
                if attempt == 5:
                    raise
        return PICTURES / f"{name}.png"

    def complaints(self) -> list[str]:
        """Return what the browser's console holds."""
        return [f"{entry['level']}: {entry['message']}" for entry in self.driver.get_log("browser")]

    def close(self) -> None:
        """End the browser."""
        self.driver.quit()
