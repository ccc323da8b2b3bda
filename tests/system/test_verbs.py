"""The list of verbs, their names of before, and what it costs to show them."""

import subprocess
import sys
from ast import literal_eval

import click
import pytest

from inteco_abs.cli.command import cli

GROUPS = ("Run:", "Sessions:", "Compare and design:", "Boards and commissioning:", "Setup:")
OLD_NAMES = {
    ("get",): "extract",
    ("blink",): "identify-led",
    ("probe",): "commission",
    ("layout",): "viewer-layout",
    ("wire", "moved"): "changes",
}


def every_verb(group=cli, above=()):
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        yield (*above, name), command
        if isinstance(command, click.Group):
            yield from every_verb(command, (*above, name))


def test_the_help_lists_every_verb_in_its_group_with_its_whole_line(main_here):
    shown = main_here("--help", check=0).stdout
    assert [line for line in shown.splitlines() if line in GROUPS] == list(GROUPS)
    for words, command in every_verb():
        line = command.help.partition("\n")[0].rstrip(".")
        if len(words) == 1:
            assert f"  {words[0]} " in shown
            assert line in shown


@pytest.mark.parametrize(("words", "command"), [pytest.param(*each, id=" ".join(each[0])) for each in every_verb()])
def test_a_verbs_line_is_one_sentence_of_at_most_60_characters(words, command):
    line = command.help.partition("\n\n")[0]
    assert len(line) <= 60, words
    assert line.endswith(".")
    assert line.split()[0].strip(",").isalpha()
    assert ". " not in line


@pytest.mark.parametrize(("old", "new"), OLD_NAMES.items(), ids=" ".join)
def test_an_old_name_works_and_is_not_listed(main_here, old, new):
    *group, _ = old
    assert main_here(*old, "--help", check=0).stdout == main_here(*group, new, "--help", check=0).stdout
    assert f"  {old[-1]} " not in main_here(*group, "--help", check=0).stdout


def test_one_verb_does_not_load_the_others():
    code = (
        "import sys; from inteco_abs.cli.command import cli\n"
        "cli.main(['faults', '--json'], standalone_mode=False)\n"
        "print(sorted(each for each in sys.modules if each.startswith('inteco_abs.cli.')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = literal_eval(done.stdout.splitlines()[-1])
    assert "inteco_abs.cli.faults" in loaded
    assert not {"inteco_abs.cli.run", "inteco_abs.cli.sweep"} & set(loaded)
