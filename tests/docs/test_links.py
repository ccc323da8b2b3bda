"""Links, paths and citations, in pages and in the source, lead somewhere."""

import re
import subprocess
import tomllib
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CODE = re.compile(r"```.*?```", re.DOTALL)
CITATION = re.compile(r"\bdocs/([\w./-]+\.md)#([\w-]+)")
"""As code, profiles and tests cite a page."""
SOURCE_TAG = re.compile(r"\b(S\d{1,2}|K\d|UM|IM)\b")
TEXT = {".py", ".md", ".toml", ".yml", ".yaml", ".sh", ".cff", ""}
GENERATED_FROM = {"docs/reference.md", "docs/troubleshooting.md"}
"""Pages that quote what commands print, with paths of the reader's own computer."""


@cache
def tracked():
    """Names of all files of this tree, new ones too, as a clone has them."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    ).stdout.splitlines()  # fmt: skip
    return [name for name in listed if (ROOT / name).is_file()]


@cache
def text_of(name):
    return (ROOT / name).read_text(encoding="utf-8")


PAGES = [name for name in tracked() if name.endswith(".md") and not name.startswith("docs/source/")]
TEXTS = [name for name in tracked() if Path(name).suffix in TEXT and not name.startswith("tests/fuzz/")]


@cache
def anchors(name):
    """What the headings of a page are called by, as GitHub does."""
    headings = re.findall(r"^#+ (.+)$", CODE.sub("", text_of(name)), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_every_link_of_every_page_leads_somewhere():
    for page in PAGES:
        for target in re.findall(r"\]\((?!https?:)([^)]+)\)", CODE.sub("", text_of(page))):
            path, _, anchor = target.partition("#")
            file = ((ROOT / page).parent / path).resolve() if path else ROOT / page
            assert file.exists(), (page, target)
            assert not anchor or anchor in anchors(str(file.relative_to(ROOT))), (page, target)


@pytest.mark.parametrize("folder", ["docs/decisions", "docs/facts"])
def test_an_index_lists_every_page_of_its_folder(folder):
    pages = {Path(page).name for page in PAGES if Path(page).parent == Path(folder)} - {"README.md"}
    assert pages
    assert pages <= set(re.findall(r"\]\(([\w.-]+\.md)\)", text_of(f"{folder}/README.md")))


def test_every_tool_is_explained_to_contributors():
    tools = {name for name in tracked() if re.fullmatch(r"tools/\w+", name)}
    assert {"tools/check", "tools/run"} <= tools
    assert tools <= set(re.findall(r"tools/\w+", text_of("CONTRIBUTING.md")))


def test_every_path_that_a_page_names_exists():
    path = re.compile(r"`((?:inteco_abs|firmware_protocol|tests|tools|docs)/[\w./-]*\w/?)`")
    named = [(page, found) for page in sorted(set(PAGES) - GENERATED_FROM) for found in path.findall(text_of(page))]
    assert [each for each in named if not (ROOT / each[1]).exists()] == []


def test_every_citation_of_a_page_names_a_heading_that_it_has():
    cited = [(name, *found) for name in TEXTS for found in CITATION.findall(text_of(name))]
    assert sum(name.endswith(".py") for name, *_ in cited) >= 25, "citations are written otherwise now"
    for name, page, anchor in cited:
        assert f"docs/{page}" in PAGES, f"{name} cites docs/{page}"
        assert anchor in anchors(f"docs/{page}"), f"{name} cites docs/{page}#{anchor}"


def test_every_source_that_profiles_and_protocol_name_is_listed_once():
    listed = re.findall(r"^### (\S+)$", text_of("docs/facts/sources.md"), re.MULTILINE)
    assert len(listed) == len(set(listed))
    contradictions = set(re.findall(r"^\| (K\d) \|", text_of("docs/facts/boards.md"), re.MULTILINE))
    places = [name for name in TEXTS if name.startswith(("inteco_abs/profiles/", "firmware_protocol/"))]
    used = {tag for name in places for tag in SOURCE_TAG.findall(text_of(name))}
    assert {"S1", "S2", "S3", "K1"} <= used
    assert used <= {*listed, *contradictions}


def test_citation_and_package_name_the_same_version():
    package = tomllib.loads(text_of("pyproject.toml"))["project"]["version"]
    assert re.findall(r"^version: (.+)$", text_of("CITATION.cff"), re.MULTILINE) == [package]
