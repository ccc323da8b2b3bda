"""The page in a real Chromium: a run started by its button, tuned by a slider, watched by a browser that dies."""

import os
import signal
import subprocess
from contextlib import suppress
from pathlib import Path

import pytest
from chromium import Browser, chromium
from serving import COMMAND, serving_command

from inteco_abs.analysis.gains import gain_changes
from inteco_abs.sessions import read_session

pytestmark = [pytest.mark.xdist_group("browser"), pytest.mark.untraced]

COLOURED = """
const canvas = document.querySelectorAll("canvas")[arguments[0]];
const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
let found = 0;
for (let at = 0; at < pixels.length; at += 4) {
  const colours = pixels.slice(at, at + 3);
  if (pixels[at + 3] > 200 && Math.max(...colours) - Math.min(...colours) > 90) found += 1;
}
return found;
"""
"""Number of pixels of a plot that lines in colour cover."""


class Page(Browser):
    """A Chromium with the served page in it."""

    def open(self, address, width=1280, height=900):
        self.command(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False
        )
        self.driver.get(address)
        self.wait("return !document.getElementById('start').disabled")

    def kill(self):
        """Let the browser die at once."""
        folder = self.driver.capabilities["chrome"]["userDataDir"]
        for process in Path("/proc").glob("[0-9]*"):
            with suppress(OSError):
                words = (process / "cmdline").read_bytes()
                if f"--user-data-dir={folder}\0".encode() in words and b"--type=" not in words:
                    os.kill(int(process.name), signal.SIGKILL)

    def click(self, css):
        self.driver.find_element("css selector", css).click()

    def text(self, css):
        return self.run("return document.querySelector(arguments[0]).textContent", css)

    def slide(self, gain, key):
        """Move a slider as a person does, by keys."""
        from selenium.webdriver.common.keys import Keys

        self.driver.find_element("css selector", f"#gain-{gain}").send_keys(getattr(Keys, key))

    def swipe_up(self, css):
        """Move a finger 200 px up from the middle of an element."""
        from selenium.webdriver.common.actions.action_builder import ActionBuilder
        from selenium.webdriver.common.actions.pointer_input import PointerInput

        box = self.run("return document.querySelector(arguments[0]).getBoundingClientRect()", css)
        x, y = int(box["x"] + box["width"] / 2), int(box["y"] + box["height"] / 2)
        gesture = ActionBuilder(self.driver, mouse=PointerInput("touch", "finger"), duration=20)
        gesture.pointer_action.move_to_location(x, y).pointer_down()
        for moved in range(20, 201, 20):
            gesture.pointer_action.move_to_location(x, y - moved)
        gesture.pointer_action.pointer_up()
        gesture.perform()
        self.settle()


@pytest.fixture
def page(chromium_driver):
    page = Page(chromium_driver)
    yield page
    chromium_driver.get("about:blank")  # it would look for its server for ever
    page.complaints()


def test_a_run_started_by_its_button_is_drawn_and_listed_also_on_a_phone(page, server):
    page.open(server.address)
    assert page.driver.current_url == f"http://127.0.0.1:{server.port}/"
    page.run("document.querySelector('[name=time]').value = 'virtual'")
    page.click("#start")
    page.wait("return document.querySelectorAll('#sessions li').length == 1")
    page.settle()
    assert "completed" in page.text("#state")
    assert "stopped in" in page.text("#result")
    assert all(page.run(COLOURED, number) > 100 for number in range(4))
    page.open(server.address, 400, 800)
    page.wait("return points.length > 100")
    page.settle()
    assert page.run("return document.documentElement.scrollWidth") <= 400
    page.swipe_up("canvas")
    assert page.run("return window.scrollY") > 100  # a finger on a plot scrolls the page
    assert page.complaints() == []


@pytest.mark.long
def test_a_gain_changed_by_slider_in_a_watched_run_replays(page, tmp_path, tmp_path_factory):
    with serving_command(tmp_path, "--set=experiment.hold_s=8") as (_, address):  # time enough on a busy computer
        page.open(address)
        with chromium(tmp_path_factory.mktemp("second")) as second_driver:
            second = Page(second_driver)
            second.open(address)
            page.click("#start")
            second.wait("return points.some((point) => point[4] === 3)")
            page.wait("return tunable.has('Mk')")
            page.slide("Mk", "PAGE_UP")
            page.wait("return document.getElementById('messages').textContent.includes('from tick')")
            changed = page.run("return Number(document.querySelector('[data-name=Mk] input[type=number]').value)")
            second.wait(f"return values.Mk == {changed}")
            second.kill()
            assert page.run("return running")  # without it
        page.wait("return !running")
        page.wait("return document.querySelectorAll('#sessions li').length == 1")
        assert "completed" in page.text("#state")
        assert all(page.run(COLOURED, number) > 100 for number in range(4))
        assert page.complaints() == []
        (path,) = tmp_path.glob("*.mcap")
        (change,) = gain_changes(read_session(path))
        assert (change.name, change.value) == ("Mk", changed)
        assert changed > 2.0
        replayed = subprocess.run([COMMAND, "replay", path], capture_output=True, text=True, check=True)
        assert "none differ" in replayed.stdout
        page.click("#sessions a")
        page.driver.switch_to.window(page.driver.window_handles[-1])
        try:
            page.wait("return window.Bokeh?.documents[0]?.is_idle")
            assert page.complaints() == []
            assert page.run("return window.origin") == "null"  # its scripts cannot act as the page does
        finally:
            page.driver.close()
            page.driver.switch_to.window(page.driver.window_handles[0])
