"""Errors in the words of a function's parameters: what is below speaks of options, as the command has them."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from functools import wraps
from typing import Final, ParamSpec, TypeVar

from inteco_abs.errors import AbsError, ArgumentError, ConfigError, ConfigIssue

P = ParamSpec("P")
T = TypeVar("T")
_OPTION: Final = re.compile(r"(?<![\w-])--([a-z][a-z-]*)")


def speaks_of_arguments(**options: str) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Decorator: errors name parameters; `options` has the parameter of each option that is not called the same."""

    def decorate(function: Callable[P, T]) -> Callable[P, T]:
        parameters = inspect.signature(function).parameters

        def words(text: str) -> str:
            return _OPTION.sub(lambda found: _parameter(found[1], options), text)

        def in_words(issue: ConfigIssue) -> ConfigIssue:
            path = options.get(issue.path, issue.path) if issue.path.isupper() else words(issue.path)
            return ConfigIssue(path, words(issue.problem), issue.place)

        @wraps(function)
        def called(*arguments: P.args, **keywords: P.kwargs) -> T:
            try:
                return function(*arguments, **keywords)
            except ConfigError as error:
                issues = [in_words(issue) for issue in error.mistakes]
                mine = all(issue.path.split(" ")[0] in {*parameters, *options.values()} for issue in issues)
                kind = ArgumentError if mine else ConfigError
                raise kind(issues).with_traceback(error.__traceback__) from error.__cause__
            except AbsError as error:
                error.args = tuple(words(each) if isinstance(each, str) else each for each in error.args)
                raise

        return called

    return decorate


def _parameter(option: str, options: Mapping[str, str]) -> str:
    name = option.replace("-", "_")
    return options.get(name, name)
