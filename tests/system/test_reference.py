"""The pages in docs: they quote the product's output, and what they name exists."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import click
import pytest

from inteco_abs.cli.command import cli
from inteco_abs.signals import EXPLANATIONS, Reason
from tests.commit import drawn_by_the_commit

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = {page.name: page.read_text(encoding="utf-8") for page in DOCS.glob("*.md")}
TROUBLE, PARITY, REFERENCE = (PAGES[f"{name}.md"] for name in ("troubleshooting", "parity", "reference"))
SOURCES = DOCS / "source"
CAPTURE = ROOT / "tools" / "capture_reference"


def capture(*arguments):
    return subprocess.run(
        [sys.executable, CAPTURE, *arguments], capture_output=True, text=True, timeout=900, check=False
    )


def every_command(group=cli, above=()):
    """Words of each command, and whether it is a group of others."""
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        yield (*above, name), isinstance(command, click.Group)
        if isinstance(command, click.Group):
            yield from every_command(command, (*above, name))


@pytest.mark.long
@pytest.mark.untraced
def test_what_a_tutorial_shows_is_what_the_commands_print_today():
    # the two other pages take three times as long; their helps and messages are compared below
    pages = sorted(str(page.relative_to(SOURCES).with_suffix("")) for page in SOURCES.glob("tutorials/*.md"))
    run = capture("--check", pages[drawn_by_the_commit(len(pages))])
    assert run.returncode == 0, run.stdout + run.stderr


@pytest.mark.long
@pytest.mark.untraced
def test_every_page_shows_what_the_commands_print_today():
    run = capture("--check", "--all")
    assert run.returncode == 0, run.stdout + run.stderr


@pytest.mark.parametrize(
    ("words", "is_group"), list(every_command()), ids=lambda value: " ".join(value) if isinstance(value, tuple) else ""
)
def test_every_command_has_a_section_with_its_help_and_a_call(words, is_group, main_here, monkeypatch):
    heading = f"\n{'#' * (len(words) + 1)} {' '.join(words)}\n"
    assert REFERENCE.count(heading) == 1
    section = re.split(r"\n#+ ", REFERENCE.partition(heading)[2], maxsplit=1)[0]
    called = re.findall(rf"^\$ .*inteco-abs {' '.join(words)}\b(.*)$", section, re.MULTILINE)
    assert " --help" in called
    assert is_group or any(call != " --help" for call in called)
    monkeypatch.setenv("COLUMNS", "80")
    shown = "\n".join(line.rstrip() for line in main_here(*words, "--help", check=0).stdout.strip("\n").splitlines())
    assert f" --help\n{shown}\n" in section


def texts_of_the_product():
    """Every text in the source, with `...` for what is put into it."""
    for file in [*(ROOT / "inteco_abs").rglob("*.py"), *(ROOT / "firmware_protocol").rglob("*.py")]:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.JoinedStr):
                yield "".join(str(part.value) if isinstance(part, ast.Constant) else "..." for part in node.values)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield node.value


def test_every_message_that_is_quoted_is_still_in_the_product():
    quoted = re.findall(r"^> (?!\*\*)(.+)$", TROUBLE, re.MULTILINE)
    texts = [re.sub(r"\s+", " ", text) for text in texts_of_the_product()]
    assert len(quoted) > 10
    for quote in quoted:
        pattern = re.compile(".*".join(re.escape(part.strip()) for part in quote.split("...")))
        assert any(pattern.search(text) for text in texts), quote


@pytest.mark.parametrize("reason", Reason, ids=lambda reason: reason.name)
def test_every_reason_is_in_the_table_in_its_own_words(reason):
    rows = [line for line in TROUBLE.splitlines() if line.startswith(f"| `{reason.name}` | {EXPLANATIONS[reason]} | ")]
    assert len(rows) == 1


def test_every_command_that_the_parity_table_names_exists():
    named = re.findall(r"`inteco-abs ([^`]+)`", PARITY)
    known = {words[0] for words, _ in every_command()}
    assert len(named) > 40
    for call in named:
        verb, *rest = call.split()
        assert verb in {*known, "--help"}, call
        options = {
            each
            for parameter in getattr(cli.get_command(click.Context(cli), verb), "params", ())
            for each in parameter.opts
        }
        assert {word for word in rest if word.startswith("--")} <= options, call


def test_every_setting_that_the_parity_table_names_exists():
    from inteco_abs.config.explain import all_keys
    from inteco_abs.control import CONTROLLERS

    known = {key.path for key in all_keys(CONTROLLERS)}
    sections = {path.partition(".")[0] for path in known}
    named = {key for key in re.findall(r"`(\w+\.\w+)", PARITY) if key.partition(".")[0] in sections}
    assert named
    assert named <= known


def test_no_page_names_the_machine_or_user_that_made_it():
    own = re.compile(r"/(tmp/(?!board\b)|root\b|work\b|home/(?!lab/rig\b))")
    pages = {page.name: page.read_text(encoding="utf-8") for page in DOCS.rglob("*.md")}
    assert {name: found[0] for name, text in pages.items() if (found := own.search(text))} == {}
