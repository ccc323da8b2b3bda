"""The verb `inteco-abs completion`, and what a shell completes for options that take a name."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Final

import click

from inteco_abs.cli.terminal import say

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

_SHELLS: Final = {"bash": "~/.bashrc", "zsh": "~/.zshrc", "fish": "~/.config/fish/completions/inteco-abs.fish"}


@click.command()
@click.argument("shell", type=click.Choice(list(_SHELLS)))
@click.pass_context
def completion(context: click.Context, shell: str) -> int:
    """Print the completion script for a shell.

    It completes verbs, options, controllers, estimators, rigs, faults and configuration keys. For bash:
    inteco-abs completion bash >> ~/.bashrc
    """
    from click.shell_completion import get_completion_class

    kind = get_completion_class(shell)
    if kind is None:  # click knows all of the choices
        raise click.UsageError(f"click cannot complete for {shell}")
    root = context.find_root()
    say(f"# completion of inteco-abs; add this to {_SHELLS[shell]}")
    say(kind(root.command, {}, "inteco-abs", "_INTECO_ABS_COMPLETE").source())
    return 0


def controller_names(_context: click.Context, _parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Controllers that ship and those of installed packages, or files."""
    from click.shell_completion import CompletionItem

    from inteco_abs.plugins import Controllers

    return _beginning(begun, Controllers()) or [CompletionItem(begun, type="file")]


def estimator_names(_context: click.Context, _parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Estimators that ship and those of installed packages."""
    from inteco_abs.control import ESTIMATORS

    return _beginning(begun, ESTIMATORS)


def key_names(_context: click.Context, _parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Keys of rig.toml."""
    from inteco_abs.config.explain import all_keys
    from inteco_abs.control import CONTROLLERS

    return _beginning(begun, dict.fromkeys(key.path for key in all_keys(CONTROLLERS)))


def rig_names(_context: click.Context, _parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Populations, each with its first rig, or files of populations."""
    from click.shell_completion import CompletionItem

    from inteco_abs.rig import POPULATIONS

    return _beginning(begun, [f"{name}:0" for name in POPULATIONS]) or [CompletionItem(begun, type="file")]


def fault_names(_context: click.Context, _parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Faults, with the sign that follows: of a value, or of the time."""
    from inteco_abs.mock_board.faults import KINDS

    return _beginning(begun, [f"{name}{'=' if kind.value else '@'}" for name, kind in KINDS.items()])


def _beginning(begun: str, names: Iterable[str]) -> list[CompletionItem]:
    from click.shell_completion import CompletionItem

    return [CompletionItem(name) for name in names if name.startswith(begun)]
