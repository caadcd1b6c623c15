"""The command line: commands parse, call and print; exit codes, and the report of bad input. No science."""

from __future__ import annotations

import os
import sys
from typing import Annotated, NoReturn

import typer

from bayes_aero import __version__
from bayes_aero.cli.fits import diagnose, export, fly, identify, path, qualify, run
from bayes_aero.cli.fits import open as open_page
from bayes_aero.cli.preparing import card, check, effects, simulate, warm
from bayes_aero.cli.terminal import BAD_INPUT, DOUBT, FAILED, INTERRUPTED, InterruptionError, refuse_gone
from bayes_aero.errors import DefectError, InputError, plain_line
from bayes_aero.processes import enable_cache, keep_freed_memory

TRACEBACK = "BAYES_AERO_TRACEBACK"
"""Set in the environment, an unexpected failure shows where in the program it happened."""

EPILOG = (
    f"Exit codes: 0 done; {FAILED} a record is not usable (check), a fit did not converge or the model "
    "cannot be simulated (fly), units of a study failed, or its cluster was lost (run), or a part of the "
    "program failed unexpectedly (reported first; the other results are written); "
    f"{BAD_INPUT} bad input, reported in one sentence; {DOUBT} done, but the records are in doubt: sensors disagree "
    f"or a channel is faulty, reported first; {INTERRUPTED} interrupted, finished stages are kept.\n\n"
    "Each command's --help has an example; a new aircraft starts with: bayes-aero card RECORD."
)

app = typer.Typer(
    name="bayes-aero",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    epilog=EPILOG,
    help="Bayesian identification of non-linear aircraft aerodynamics from flight data.",
)


def _version(requested: bool) -> bool:
    if requested:
        typer.echo(f"bayes-aero {__version__}")
        raise typer.Exit
    return requested


@app.callback()
def _options(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="The version.")] = False,
) -> None:
    """Bayesian identification of non-linear aircraft aerodynamics from flight data."""


for command in (identify, diagnose, fly, export, qualify, open_page, path, simulate, run, card, check, effects, warm):
    app.command()(command)


def main() -> None:
    """Entry point: bad input is one sentence and exit status 2, Ctrl-C is 130."""

    def stop(text: str, code: int) -> NoReturn:
        print(text, file=sys.stderr)
        sys.exit(code)

    enable_cache()
    keep_freed_memory()
    try:
        refuse_gone(sys.argv[1:])
        app(prog_name=app.info.name)
    except InputError as error:
        stop(f"error: {error}", BAD_INPUT)
    except OSError as error:  # a full disk, a name that is too long: whatever the sentences before have not foreseen
        where = f"{error.filename}: " if error.filename else ""
        stop(f"error: {plain_line(f'{where}{error.strerror or error}')}; check the path and the disk", BAD_INPUT)
    except MemoryError:
        stop("error: there is not enough memory for this; take fewer or shorter records", BAD_INPUT)
    except InterruptionError as stopped:
        stop(f"interrupted; {stopped}", INTERRUPTED)
    except DefectError as defect:
        stop(f"error: {defect}", FAILED)
    except ImportError:  # Ctrl-C in the midst of a library's first import ends so; the entry point knows
        raise
    except Exception as error:
        if os.environ.get(TRACEBACK):
            raise
        what = plain_line(f"{type(error).__name__}: {error}")
        report = f"please report it with the command, the card and what {TRACEBACK}=1 in the environment then prints"
        stop(f"error: the command failed unexpectedly ({what}). This is a defect of the program; {report}", FAILED)
    except SystemExit as stopped:
        if stopped.code == INTERRUPTED:  # typer's own, before a command had begun its work
            print("interrupted; nothing had been written yet, give the same command again", file=sys.stderr)
        raise
