"""Commands from functions: parameters become words and options, the docstring becomes the help::

    @command("wave", "pcs-racing wave Ada --times 3")
    def wave(
        name: Annotated[str, Option("name to greet")],
        *,
        times: Annotated[int, Option("number of waves", "N")] = 1,
        workers: Workers,
    ) -> None:
        "Wave at somebody."

A parameter before ``*`` is a word of the command line, optional if it has a default; a parameter
after ``*`` is an option. The type decides the parsing: ``bool`` is a switch, ``Sequence[T]`` takes
one or more values, and ``tuple[T, T]`` two. A dataclass with fields declared like parameters is a
group of options.
"""

import argparse
import re
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, is_dataclass
from functools import partial
from inspect import Parameter, getdoc, signature
from types import ModuleType, NoneType, UnionType
from typing import Annotated, Any, NoReturn, get_args, get_origin, get_type_hints

from pcs_racing.base.errors import choices, did_you_mean
from pcs_racing.base.settings import Settings, option_words, options_of

Parsers = argparse._SubParsersAction  # result type of ``add_subparsers``, without a public name


@dataclass(frozen=True)
class Option:
    """Help text of a parameter; the default is appended."""

    help: str
    metavar: str | tuple[str, ...] | None = None
    choices: Iterable[Any] | None = None


class ConfigOptions:
    """A parameter for the options of a class stated on the command line, by name."""

    def __init__(self, cls: type[Settings], *names: str) -> None:
        self.cls, self.names = cls, names

    def add(self, parser: ArgumentParser) -> None:
        """Add an option for each field."""
        options = options_of(self.cls)
        for name in self.names:
            several = get_origin(options[name].kind) is tuple  # numbers or annotated names
            kind = get_args(get_args(options[name].kind)[0])[0] if several else options[name].kind
            parser.add_argument(
                f"--{name.replace('_', '-')}",
                type=kind,
                nargs="+" if several else None,
                metavar={int: "N", float: "X"}.get(kind, name.upper()),
                help=_phrase(option_words(options[name], options[name].default != ())),
            )

    def values(self, parsed: Namespace) -> dict[str, Any]:
        """Return the stated values, with lists converted to tuples."""
        stated = {
            name: getattr(parsed, name) for name in self.names if getattr(parsed, name) is not None
        }
        return {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in stated.items()
        }


@dataclass(frozen=True)
class Command:
    """A command, or a group of commands (without a function)."""

    name: str  #: Name as typed, with the group's name first if any.
    summary: str
    examples: tuple[str, ...]
    function: Callable[..., None] | None = None


class Parser(ArgumentParser):
    """A parser that prints an error as one line, with the nearest valid words."""

    def error(self, message: str) -> NoReturn:
        """End the process with status 2."""
        found = re.match(r"(.*): invalid choice: '(.*)' \(choose from (.*)\)$", message)
        unknown = re.match(r"unrecognized arguments: (--[^\s=]+)", message)
        options = list(_options(self)) if unknown else []
        if unknown and unknown[1] in options:
            message = f"option {unknown[1]} belongs to another command"
        elif unknown and (near := did_you_mean(unknown[1], options)):
            message = f"option {unknown[1]} is unknown{near}"
        if found:
            where, word, known = found.groups()
            message = (
                f"{where} is {word!r}; {choices(word, known.replace(chr(39), '').split(', '))}"
            )
        self.exit(2, f"{self.prog}: error: {message}; 'pcs-racing help' lists all commands\n")


def command(name: str, *examples: str) -> Callable[[Callable[..., None]], Command]:
    """Turn a function into a command; the first paragraph of its docstring is the summary."""

    def make(function: Callable[..., None]) -> Command:
        summary = str(getdoc(function)).partition("\n\n")[0]
        return Command(name, summary.replace("\n", " "), examples, function)

    return make


def add_commands(parsers: "Parsers[ArgumentParser]", module: ModuleType) -> None:
    """Add all commands of a module, in their order; a group precedes its commands."""
    groups = {"": parsers}
    # A module's names are in the order of the file, which is the order of the help.
    for made in [value for value in vars(module).values() if isinstance(value, Command)]:
        group, _, name = made.name.rpartition(" ")
        parser = groups[group].add_parser(
            name,
            help=_phrase(made.summary),
            description=made.summary,
            epilog="\n  ".join(
                ["examples:" if len(made.examples) > 1 else "example:", *made.examples]
            ),
            formatter_class=RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )
        if made.function is None:
            groups[name] = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
        else:
            add_parameters(parser, made.function)
            parser.set_defaults(run=partial(_run, made.function))


def _run(function: Callable[..., None], parsed: Namespace) -> None:
    function(**parameter_values(function, parsed))


def add_parameters(
    parser: ArgumentParser, target: Callable[..., Any], title: str | None = None
) -> None:
    """Add a function's parameters, or a dataclass's fields as a group of options, to a parser."""
    group = parser.add_argument_group(title) if title else parser
    for parameter, kind, declared in _parameters(target):
        if isinstance(declared, ConfigOptions):
            declared.add(parser)
        elif declared is None:
            add_parameters(parser, kind, _phrase(str(getdoc(kind)).partition("\n")[0]))
        else:
            group.add_argument(*_name(parameter), **_reading(parameter, kind, declared))


def parameter_values(target: Callable[..., Any], parsed: Namespace) -> dict[str, Any]:
    """Return the command line's values for the parameters added by :func:`add_parameters`."""
    values = {}
    for parameter, kind, declared in _parameters(target):
        if isinstance(declared, ConfigOptions):
            values[parameter.name] = declared.values(parsed)
        elif declared is None:
            values[parameter.name] = kind(**parameter_values(kind, parsed))
        else:
            values[parameter.name] = getattr(parsed, parameter.name)
    return values


def _parameters(
    target: Callable[..., Any],
) -> Iterator[tuple[Parameter, Any, Option | ConfigOptions | None]]:
    """Yield parameters with their types and declarations (None for a dataclass of options)."""
    hints = get_type_hints(target, include_extras=True)
    for name, parameter in signature(target).parameters.items():
        hint = hints[name]
        if get_origin(hint) is Annotated:
            kind, declared = get_args(hint)
            yield parameter, kind, declared
        else:
            assert is_dataclass(hint), f"parameter {name} is not declared"
            yield parameter, hint, None


def _phrase(sentence: str) -> str:
    """Return a sentence as an argparse help text: lower-case first letter, no full stop."""
    return f"{sentence[0].lower()}{sentence[1:].rstrip('.')}".replace("%", "%%")


def _options(parser: ArgumentParser) -> Iterator[str]:
    """Yield all options of a parser and of its commands."""
    yield from parser._option_string_actions
    for action in parser._actions:
        if isinstance(action, Parsers):
            for each in action.choices.values():
                yield from _options(each)


def _name(parameter: Parameter) -> tuple[str, ...]:
    word = parameter.kind is not Parameter.KEYWORD_ONLY
    return (parameter.name,) if word else (f"--{parameter.name.replace('_', '-')}",)


def _reading(parameter: Parameter, kind: Any, option: Option) -> dict[str, Any]:
    """Return argparse's arguments for a parameter."""
    word, needed = (
        parameter.kind is not Parameter.KEYWORD_ONLY,
        parameter.default is Parameter.empty,
    )
    default = None if needed else parameter.default
    said = " ".join(map(str, default)) if isinstance(default, tuple) else default
    # `is False`, not falsehood: a default of 0 is worth showing.
    shown = "" if default is None or default is False or default == () else f" (default: {said})"
    reading: dict[str, Any] = {
        "default": default,
        "help": f"{option.help}{shown}".replace("%", "%%"),
    }
    if kind is bool:
        return {**reading, "action": "store_true"}
    # A type or None: None means that the option was not stated.
    if get_origin(kind) is UnionType:
        (kind,) = (part for part in get_args(kind) if part is not NoneType)
    # The origin of ``Sequence[str]`` is the class of collections.abc imported above.
    if get_origin(kind) is Sequence:
        kind, reading["nargs"] = get_args(kind)[0], "+"
    elif get_origin(kind) is tuple:
        kind, reading["nargs"] = get_args(kind)[0], len(get_args(kind))
    elif word and not needed:
        reading["nargs"] = "?"
    if not word:
        reading["required"] = needed
        reading["metavar"] = option.metavar or {int: "N", float: "X"}.get(kind)
    elif option.metavar is not None:
        reading["metavar"] = option.metavar
    choices = None if option.choices is None else list(option.choices)
    return {**reading, "type": kind, "choices": choices}
