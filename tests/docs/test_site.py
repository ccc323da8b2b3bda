"""The documentation site: built, every link followed, and searched in a real Chromium from files."""

import json
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import nbformat
import pytest
from chromium import Browser

ROOT = Path(__file__).parents[2]
TITLE = "inteco-abs"
NOTEBOOKS = sorted((ROOT / "docs/tutorials/notebooks").glob("*.ipynb"))
NOTEBOOK = "docs/tutorials/notebooks/1-first-stop"

pytestmark = [pytest.mark.xdist_group("browser"), pytest.mark.untraced]


class Page(HTMLParser):
    """What a page links to, what it loads to be shown, and what can be linked to in it."""

    def __init__(self, path):
        super().__init__()
        self.path, self.links, self.loads, self.anchors = path, [], [], set()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        facts = dict(attrs)
        self.anchors |= {facts[name] for name in ("id", "name") if facts.get(name)}
        if tag == "a" and "href" in facts:
            self.links.append(facts["href"])
        elif tag == "link" and facts.get("rel") in {"stylesheet", "preload", "icon"}:
            self.loads.append(facts["href"])
        elif "src" in facts:
            self.loads.append(facts["src"])

    def broken(self, pages):
        """Links and loads that lead nowhere; of the outside only the form of the address is looked at."""
        for link in [*self.links, *self.loads]:
            parts = urlsplit(link)
            if parts.scheme == "data":
                continue
            if parts.scheme:
                right = parts.scheme in {"http", "https"} and re.fullmatch(r"[\w.-]+\.\w+(:\d+)?", parts.netloc)
                if link in self.loads or not (right or link.startswith("mailto:")):
                    yield link
                continue
            file = (self.path.parent / unquote(parts.path)).resolve() if parts.path else self.path
            if not file.is_file() or (parts.fragment and unquote(parts.fragment) not in pages[file].anchors):
                yield link


def built(folder, **environment):
    """The site, built as a developer builds it."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    build = subprocess.run(
        [ROOT / "tools/build_docs", folder],
        env={**os.environ, "PATH": path, **environment},
        capture_output=True, text=True, timeout=1800, check=False,
    )  # fmt: skip
    assert build.returncode == 0, build.stdout + build.stderr
    return folder


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site without what its notebooks print and draw."""
    return built(tmp_path_factory.mktemp("site"), NOTEBOOKS="unexecuted")


@pytest.fixture(scope="module")
def pages(site):
    return {path: Page(path) for path in site.rglob("*.html")}


@pytest.fixture(scope="module")
def browser(chromium_driver):
    return Browser(chromium_driver)


@pytest.mark.long
def test_every_link_resolves_and_nothing_is_loaded_from_elsewhere(pages):
    assert sum(len(page.links) for page in pages.values()) > 1000
    assert {str(path): links for path, page in pages.items() if (links := list(page.broken(pages)))} == {}


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
@pytest.mark.long
def test_a_notebook_can_be_downloaded(path, site, pages):
    page = site / path.relative_to(ROOT).with_suffix(".html")
    (download,) = [link for link in pages[page].links if link.endswith(path.name)]
    assert (page.parent / download).read_bytes() == path.read_bytes()


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_kept_without_outputs_and_checks_itself(path):
    notebook = json.loads(path.read_text(encoding="utf-8"))
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert not any(cell["outputs"] or cell["execution_count"] for cell in code)
    assert sum("assert " in "".join(cell["source"]) for cell in code) >= 2
    nbformat.validate(notebook)


@pytest.mark.long
def test_the_whole_build_runs_every_notebook_and_shows_what_its_cells_made(tmp_path):
    site = built(tmp_path / "site")
    for path in NOTEBOOKS:
        text = (site / path.relative_to(ROOT).with_suffix(".html")).read_text(encoding="utf-8")
        assert 'class="output stderr' not in text
        assert text.count('class="output ') >= 4
        assert ".png" in text


@pytest.mark.long
def test_a_word_that_is_searched_for_leads_to_its_page(browser, site, tmp_path):
    browser.show(site / "index.html")
    browser.wait("return document.querySelector('.sidebar-search')")
    assert TITLE in browser.driver.title
    browser.complaints()
    box = browser.driver.find_element("css selector", ".sidebar-search")
    box.send_keys("reaching_law_torque")
    box.submit()
    browser.wait("return document.querySelector('.search li a')")
    browser.driver.find_element("css selector", ".search li a").click()
    browser.wait("return document.getElementById('inteco_abs.control.reaching_law_torque')")
    photograph = tmp_path / "page.png"
    assert browser.driver.save_screenshot(str(photograph))
    assert len(photograph.read_bytes()) > 20_000
    assert browser.complaints() == []


@pytest.mark.parametrize("width", [390, 1280])
@pytest.mark.long
def test_a_page_is_no_wider_than_its_window(browser, site, width):
    for name in ("README", "docs/tutorials/1-first-stop", "docs/api/4-boards", "firmware_protocol/PROTOCOL", NOTEBOOK):
        browser.show(site / f"{name}.html", width=width)
        assert browser.run("return document.documentElement.scrollWidth") <= width, name
