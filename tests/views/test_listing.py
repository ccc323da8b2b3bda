"""The page of a folder, looked at in a browser: rows, filter, order, curves."""

import re

import pytest

from inteco_abs.analysis import session_rows
from inteco_abs.errors import ConfigError
from inteco_abs.views.listing import write_listing

pytestmark = pytest.mark.xdist_group("browser")


@pytest.fixture
def page(session, others, tmp_path):
    folder = tmp_path / "runs"
    folder.mkdir()
    for name, each in (("<i>a", session), ("b", others[0]), ("c", others[1])):
        (folder / f"{name}.mcap").write_bytes(each.path.read_bytes())
    (folder / "d.mcap").write_bytes(b"no session")
    path = tmp_path / "list.html"
    write_listing(session_rows(folder, index=tmp_path / "index.sqlite"), path)
    return path


def test_rows_curves_filter_and_order(chromium_driver, page):
    driver = chromium_driver
    driver.get(page.as_uri())
    names = "return [...document.querySelectorAll('tbody tr')].filter(r => !r.hidden).map(r => r.cells[0].textContent)"
    assert len(driver.execute_script(names)) == 4
    assert any(name.endswith("<i>a.mcap") for name in driver.execute_script(names))
    lengths = driver.execute_script("return [...document.querySelectorAll('td polyline')].map(l => l.getTotalLength())")
    assert sum(length > 20.0 for length in lengths) == 3
    assert len(driver.execute_script("return [...document.querySelectorAll('.lines line')]")) >= 2
    driver.find_element("id", "filter").send_keys("completed b.mcap")
    assert [name[-6:] for name in driver.execute_script(names)] == ["b.mcap"]
    assert driver.find_element("id", "count").text == "1 of 4"
    driver.find_element("id", "filter").clear()
    driver.execute_script("document.getElementById('filter').dispatchEvent(new Event('input'))")
    values = (
        "return [...document.querySelectorAll('tbody tr')].map(r => parseFloat(r.cells[arguments[0]].dataset.value))"
    )
    heads = [head.text for head in driver.find_elements("tag name", "th")]
    column = heads.index("rig") + 1
    driver.find_elements("tag name", "th")[column].click()
    rising = [value for value in driver.execute_script(values, column) if value is not None]
    assert rising == sorted(rising)
    assert driver.execute_script("return performance.getEntriesByType('resource').length") == 0


def test_the_page_is_one_file_and_refuses_a_wrong_name(page, tmp_path):
    text = page.read_text(encoding="utf-8")
    assert not re.search(r"(src|href)=", text)
    assert "<i>a" not in text
    with pytest.raises(ConfigError, match=r"must end in \.html"):
        write_listing([], tmp_path / "list.txt")
