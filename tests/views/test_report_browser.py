"""Reports in a real Chromium, without a network: drawn, zoomed together, in light and dark, on paper."""

import base64
import io
from pathlib import Path

import numpy as np
import pytest
from chromium import Browser
from PIL import Image

from inteco_abs.signals import Phase
from inteco_abs.views.report import write_report

pytestmark = [pytest.mark.xdist_group("browser"), pytest.mark.untraced]

EVIL = "</script><script>window.pwned=1</script><img src=x onerror=window.pwned=1>"
OVER_TIME = ("speeds", "slip", "torque", "duty", "switching", "timing")
BLUE, RED = (0x00, 0x72, 0xB2), (0xD5, 0x5E, 0x00)


class ReportBrowser(Browser):
    """A Chromium with a report in it."""

    def show(self, path: Path, scheme="light", width=1280, *, touch=False):
        super().show(path, scheme, width, touch=touch)
        self.wait("return [...document.querySelectorAll('figure')].length == 0 || Bokeh.documents[0]?.is_idle")
        self.settle()

    def plot(self, name):
        """Its element, in the middle of the window."""
        found = self.driver.find_element("css selector", f"#{name} > div > div")
        self.run("arguments[0].scrollIntoView({block: 'center'})", found)
        self.settle()
        return found

    def picture(self, name):
        """Pixels of a plot."""
        return np.asarray(Image.open(io.BytesIO(self.plot(name).screenshot_as_png)).convert("RGB")).astype(int)

    def ranges(self, name):
        return self.run(
            "const r = Bokeh.documents[0].get_model_by_name(arguments[0]).x_range; return [r.start, r.end]", name
        )

    def drag(self, name, from_px, to_px):
        from selenium.webdriver import ActionChains

        plot = self.plot(name)
        chain = ActionChains(self.driver, duration=50).move_to_element_with_offset(plot, from_px, 0).click_and_hold()
        chain.move_to_element_with_offset(plot, to_px, 0).release().perform()
        self.settle()

    def swipe_up(self, name):
        """How far a finger that moves up over a plot scrolls the page, px."""
        from selenium.webdriver.common.actions.action_builder import ActionBuilder
        from selenium.webdriver.common.actions.pointer_input import PointerInput

        place, before = self.plot(name).rect, self.run("return window.scrollY")
        x, y = place["x"] + place["width"] / 2, place["y"] + place["height"] / 2 - before
        actions = ActionBuilder(self.driver, mouse=PointerInput("touch", "finger"), duration=200)
        finger = actions.pointer_action
        finger.move_to_location(int(x), int(y)).pointer_down().move_to_location(int(x), int(y) - 200).pointer_up()
        actions.perform()
        self.settle()
        self.settle()
        return self.run("return window.scrollY") - before

    def point_at(self, name):
        from selenium.webdriver import ActionChains

        plot = self.plot(name)
        ActionChains(self.driver, duration=50).move_to_element(plot).perform()
        self.settle()


def of_colour(pixels, colour):
    return int((np.abs(pixels - np.array(colour)).max(axis=-1) < 60).sum())


@pytest.fixture(scope="module")
def browser(chromium_driver):
    return ReportBrowser(chromium_driver)


@pytest.fixture(scope="module")
def page(session, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "stop.html"
    write_report([session], path)
    return path


@pytest.fixture(scope="module")
def two_stops(session, others, tmp_path_factory):
    path = tmp_path_factory.mktemp("two") / "stops.html"
    write_report([session, others[0]], path)
    return path


def test_everything_is_drawn_and_nothing_complains(browser, page):
    browser.show(page)
    for name in (*OVER_TIME, "plane"):
        assert of_colour(browser.picture(name), BLUE) > 100, name
    for name in ("speeds", "slip", "torque", "plane"):
        assert of_colour(browser.picture(name), RED) > 20, name
    assert len(np.unique(browser.picture("lateness").reshape(-1, 3), axis=0)) > 10
    assert browser.complaints() == []
    assert browser.run("return performance.getEntriesByType('resource').map(entry => entry.name)") == []


@pytest.mark.long
def test_a_zoom_in_one_plot_is_a_zoom_in_all(browser, page):
    browser.show(page)
    whole, before = browser.ranges("slip"), browser.picture("speeds")
    browser.drag("slip", -200, 100)
    start, end = browser.ranges("slip")
    assert whole[0] < start < end < whole[1]
    assert all(browser.ranges(name) == [start, end] for name in OVER_TIME)
    assert (np.abs(browser.picture("speeds") - before).max(axis=-1) > 60).sum() > 100
    browser.run("document.querySelector('button[data-from]').click()")
    assert browser.ranges("timing") == pytest.approx(whole)


@pytest.mark.long
def test_a_phone_scrolls_over_plots_and_shows_the_table_of_results_whole(browser, two_stops):
    browser.show(two_stops, width=400, touch=True)
    assert browser.swipe_up("slip") > 100
    width, room = browser.run(
        "const t = document.querySelector('.result .wide'); return [t.scrollWidth, t.clientWidth]"
    )
    assert width <= room
    browser.show(two_stops)


@pytest.mark.long
def test_the_cursor_shows_the_values_of_all_plots(browser, page, session):
    browser.show(page)
    browser.point_at("speeds")
    at_s = float(browser.run("return document.getElementById('when').textContent").split()[1])
    shown = browser.run("return [...document.querySelectorAll('#slip output')].map(each => Number(each.textContent))")
    start_ns = float(session.ticks["time_ns"][session.ticks["phase"] == Phase.BRAKING][0])
    row = int(np.abs(session.truth["time_ns"] - start_ns - at_s * 1e9).argmin())
    near = session.truth["slip"][row - 1 : row + 2]
    assert len(np.unique(session.truth["slip"][row - 9 : row + 9])) > 9
    assert near.min() * 0.9995 <= shown[1] <= near.max() * 1.0005


@pytest.mark.long
def test_an_entry_of_a_legend_hides_its_line(browser, page):
    browser.show(page)
    hide = "document.querySelector('#speeds button.key').click()"
    shown = of_colour(browser.picture("speeds"), RED)
    browser.run(hide)
    assert of_colour(browser.picture("speeds"), RED) < shown / 10
    browser.run(hide)
    assert of_colour(browser.picture("speeds"), RED) == shown


@pytest.mark.parametrize("width", [1280, 420])
@pytest.mark.long
def test_plots_follow_the_page_into_the_dark_and_back(browser, page, width):
    browser.show(page, "light", width)
    for scheme in ("light", "dark", "light"):
        browser.command("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        pixels = browser.picture("speeds").mean(axis=-1)
        ground = np.median(pixels)
        assert ground > 240 if scheme == "light" else ground < 40
        letters = pixels[:, :70]  # the numbers of the axis
        assert (np.abs(letters - ground) > 150).sum() > 50
    assert browser.run("return document.documentElement.scrollWidth") <= width


@pytest.mark.long
def test_paper_gets_the_figure_in_place_of_the_plots(browser, page):
    browser.show(page)
    browser.command("Emulation.setEmulatedMedia", media="print")
    try:
        shown = "return getComputedStyle(document.querySelector(arguments[0])).display"
        assert browser.run(shown, ".plots") == "none"
        assert browser.run(shown, ".picture") != "none"
        assert browser.run("return document.querySelector('.picture img').naturalWidth") > 100
        assert len(base64.b64decode(browser.command("Page.printToPDF")["data"])) > 20_000
    finally:
        browser.command("Emulation.setEmulatedMedia", media="")


@pytest.mark.long
def test_comparison_draws_odd_sessions_and_runs_none_of_their_code(
    browser, session, others, faulty, with_facts, tmp_path
):
    evil = with_facts(others[0], "controller", name=EVIL, estimator=EVIL)
    one = others[1].with_rows(others[1].ticks[:1], others[1].truth[:0])
    write_report([session, evil, faulty, one], tmp_path / "comparison.html")
    browser.show(tmp_path / "comparison.html")
    assert of_colour(browser.picture("slip"), BLUE) > 100
    assert of_colour(browser.picture("slip"), RED) > 100
    assert browser.run("return window.pwned") is None
    assert EVIL in browser.run("return document.body.innerText")
    assert browser.complaints() == []


def test_a_session_without_ticks_is_a_quiet_page(browser, session, tmp_path):
    write_report([session.with_rows(session.ticks[:0], session.truth[:0])], tmp_path / "empty.html")
    browser.show(tmp_path / "empty.html")
    assert browser.complaints() == []
