"""All commands in one table of contents, and the one place that turns errors into lines and exit codes."""

from __future__ import annotations

import itertools
import os
import re
import sys
from typing import Annotated, Any

import typer

from hexmap.base.errors import ArgumentError, HexmapError, LatticeError
from hexmap.base.text import printable
from hexmap.cli import (
    benchmark,
    build,
    experiments,
    localisation_experiment,
    localise,
    mapping,
    page,
    showing,
    trajectories,
    viewing,
)
from hexmap.cli.plan import command as planning
from hexmap.cli.plan.query import PlanCommand
from hexmap.cli.usage import Command

__all__ = ["app", "run"]

STOPPED = 130
# What the parser says of words that are no numbers.
_JARGON = {"valid integer": "a whole number", "valid number": "a number", "valid boolean": "true or false"}
_OUTPUTS = ("-o", "--output", "--picture", "--loops-picture", "--csv", "--json", "--write-times")

app = typer.Typer(
    name="hexmap",
    help="Maps and paths on square, hexagonal, cubic, FCC and BCC lattices, from laser logs.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command(cls=Command, short_help="Simulate an office, map it and plan through it.")(mapping.demo)
app.command(cls=Command, short_help="Simulate a drive through a building.")(mapping.simulate)
app.command(cls=Command, short_help="Build a map from logs of a laser or a LiDAR.")(build.build)
app.command(cls=Command, short_help="Find a robot in a map and follow it along a log.")(localise.localise)
app.command(cls=Command, short_help="Merge maps of one place, cell by cell.")(mapping.merge)
app.command(cls=Command, short_help="Cut a part out of a map.")(viewing.crop)
app.command(cls=Command, short_help="Score trajectories against a reference or relations.")(trajectories.evaluate)
app.command(cls=Command, short_help="Write a trajectory in another format.")(trajectories.convert)
app.command(cls=Command, short_help="Say what a map or a log holds and where it is from.")(viewing.info)
app.command(cls=Command, short_help="Print what each lattice is worth: Table I.")(viewing.lattices)
app.command(cls=Command, short_help="Draw a map, or points, with their true cells.")(showing.show)
app.command(cls=Command, short_help="Make a page of a map, to look and plan in.")(page.page)
app.command(cls=Command, short_help="Write a map in a format that other programs read.")(viewing.export)
app.command(cls=PlanCommand, short_help="Plan a path between two positions in a map.")(planning.plan)
experiments.app.command(cls=Command, short_help="Compare lattices at localising on your own log.")(
    localisation_experiment.localisation
)
app.add_typer(experiments.app, name="experiment")
app.add_typer(benchmark.app, name="benchmark")


def _print_version(wanted: bool) -> None:
    if wanted:
        from hexmap.base.version import __version__

        typer.echo(f"hexmap {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    pass


def run(arguments: list[str]) -> int:
    """Run the command that ``arguments`` name; return the exit code."""
    try:
        code = app(args=arguments, prog_name="hexmap", standalone_mode=False)
        sys.stdout.flush()
        if code == STOPPED:  # the parser has turned Ctrl-C into this code
            raise KeyboardInterrupt
        return code if isinstance(code, int) else 0
    except HexmapError as error:
        if isinstance(error, (ArgumentError, LatticeError)) and not _is_of_a_file(str(error), arguments):
            return _misused(str(error), _command_path(arguments))
        return _fail(str(error))
    except SystemExit as leaving:
        # The parser leaves this way with 1 when the reader of our output has gone (hexmap info m.parquet | head).
        return 0 if type(sys.stdout).__name__ == "PacifyFlushWrapper" else int(leaving.code or 0)
    except BrokenPipeError:
        # The reader of our output left (hexmap info m.parquet | head); keep the interpreter from saying so again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except MemoryError:
        return _fail("not enough memory for this; take a coarser resolution or fewer levels")
    except OSError as error:
        return _fail(f"{error.filename or 'a file'}: {error.strerror or error}")
    except Exception as error:
        # Wrong usage: the parser's own errors know their code and their text.
        if hasattr(error, "format_message") and hasattr(error, "exit_code"):
            text = error.format_message()
            if type(error).__name__ == "NoArgsIsHelpError":
                sys.stderr.write(text.rstrip() + "\n")
            elif "is not readable" in text:  # a bad file, not wrong usage
                return _fail(text)
            elif text:
                context = getattr(error, "ctx", None)
                text = _in_plain_words(text, arguments)
                _misused(text, _command_path(arguments) if context is None else context.command_path)
            return int(error.exit_code)
        if type(error).__name__ == "Abort":
            raise KeyboardInterrupt from error
        raise


def _in_plain_words(text: str, arguments: list[str]) -> str:
    """Return what the parser says of a value that it cannot convert, with the value and without the parser's jargon."""
    found = re.match(r"Invalid value for '?(-[-\w]+)[^:]*: ", text)
    for jargon, words in _JARGON.items():
        if jargon in text and found is not None:
            option = found[1]
            given = [b for a, b in itertools.pairwise([*arguments, ""]) if a == option]
            given += [word.partition("=")[2] for word in arguments if word.startswith(f"{option}=")]
            return f"{option} takes {words}" + (f", not {given[0]!r}" if len(given) == 1 else "")
    return text.replace("Value error, ", "")


def _is_of_a_file(text: str, arguments: list[str]) -> bool:
    """Tell whether an error is of a file that is read: it begins with the name; of an option's value it does not.

    The name of an output is the value of an option.
    """
    words = []
    for before, word in itertools.pairwise(["", *arguments]):
        option, _, value = word.partition("=")
        if before not in _OUTPUTS and option not in _OUTPUTS:
            words += [part for part in (word, value) if part]
    return any(text.startswith((f"{word}: ", f"{os.path.normpath(word)}: ")) for word in words)


def _command_path(arguments: list[str]) -> str:
    """Return the command that was called, such as "hexmap experiment rotation"."""
    at: Any = typer.main.get_command(app)
    path = ["hexmap"]
    for word in arguments:
        at = getattr(at, "commands", {}).get(word)
        if at is None:
            break
        path.append(word)
    return " ".join(path)


def _one_line(text: str) -> str:
    return re.sub("[ \n]+", " ", printable(text)).strip()


def _misused(text: str, command: str) -> int:
    sys.stderr.write(f"hexmap: {_one_line(text)} (see: {command} --help)\n")
    return 2


def _fail(text: str) -> int:
    sys.stderr.write(f"hexmap: {_one_line(text)}\n")
    return 1
