"""A real Chromium without a network, for pages that are opened from files or served on this computer."""

import os
import shutil
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--force-color-profile=srgb",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
)


class Browser:
    """A Chromium with a page in it."""

    def __init__(self, driver):
        self.driver = driver

    def show(self, path: Path, scheme="light", width=1280, *, touch=False):
        self.command("Emulation.setTouchEmulationEnabled", enabled=touch)
        self.command("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        self.command("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False)
        self.driver.get(path.as_uri())

    def command(self, name, **arguments):
        return self.driver.execute_cdp_cmd(name, arguments)

    def run(self, script, *arguments):
        return self.driver.execute_script(script, *arguments)

    def wait(self, script):
        end = time.monotonic() + 30.0
        while not self.run(script):
            assert time.monotonic() < end, script
            time.sleep(0.05)

    def settle(self):
        """Two frames, so that what was asked for has been drawn."""
        self.driver.execute_async_script(
            "const done = arguments[0]; requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 50)))"
        )

    def complaints(self):
        """What the console holds beyond information, since it was last asked."""
        return [entry["message"] for entry in self.driver.get_log("browser") if entry["level"] not in {"INFO", "DEBUG"}]


@contextmanager
def chromium(folder):
    """The driver of a Chromium that keeps its files in `folder`."""
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = _program("chromium")
    for flag in (*FLAGS, f"--user-data-dir={folder}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(_program("chromedriver")))
    try:
        yield driver
    finally:
        driver.quit()


def _program(name):
    found = shutil.which(name)
    if found is None:
        missing = f"{name} is missing: apt-get install chromium chromium-driver"
        if os.environ.get("CI"):
            pytest.fail(missing)
        pytest.skip(missing)
    return found
