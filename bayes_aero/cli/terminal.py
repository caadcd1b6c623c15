"""What all commands share: exit codes, options of their classes, the bar, JSON on stdout."""

from __future__ import annotations

import inspect
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import fields
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_type_hints

import typer
from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as ProgressBar

from bayes_aero.errors import InputError
from bayes_aero.jobs.options import MAX_SEED, Options, ReadingOptions
from bayes_aero.progress import Progress

if TYPE_CHECKING:
    from bayes_aero.flight.card import Card
    from bayes_aero.flight.health import Consistency, HealthFinding
    from bayes_aero.flight.record import FlightRecord
    from bayes_aero.report.screen import Screen

FAILED = 1
BAD_INPUT = 2
DOUBT = 3  # done and written, but sensors disagree or a channel is faulty
INTERRUPTED = 130
COLUMNS = 100  # of the screen, where the terminal has as many
ALL = "All findings\n"  # before the text of the page

SUFFIXES = ".csv .asc .mat .xlsx .mf4 .ulg .bin .parquet .nc"
RECORDS = f"Flight records ({SUFFIXES}), or parts of them, FILE@FROM:TO in seconds"

RecordsArgument = Annotated[list[Path], typer.Argument(help=f"{RECORDS}.")]
ResultArgument = Annotated[str, typer.Argument(help="Folder (or JSON file) of a result.", metavar="RESULT")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON and nothing else on stdout.")]
TimingsOption = Annotated[bool, typer.Option("--timings", help="Print the seconds of each stage, on stderr.")]
VerboseOption = Annotated[bool, typer.Option("--verbose", help="Print the text of the page below the screen.")]
SeedOption = Annotated[int, typer.Option(min=0, max=MAX_SEED, help="Same seed, same machine: same numbers.")]
OutOption = Annotated[Path, typer.Option(help="Folder for the results.")]
ResultCardOption = Annotated[str | None, typer.Option(help="The result's card, if not found.", metavar="CARD")]
Command = TypeVar("Command", bound=Callable[..., None])


def with_options(command: Command) -> Command:
    """The command with each parameter that is a class of options spread out: one option a field."""
    hints, parameters, classes = get_type_hints(command, include_extras=True), [], {}
    for p in inspect.signature(command).parameters.values():
        hint = hints[p.name]
        if not (isinstance(hint, type) and issubclass(hint, Options)):
            parameters.append(p.replace(kind=p.KEYWORD_ONLY, annotation=hint))
            continue
        rows = {f.metadata["name"] or f.name: f for f in fields(hint) if f.metadata["name"] is not None}  # type: ignore[arg-type]
        classes[p.name] = hint, rows
        for name, f in rows.items():
            row = {**f.metadata["row"], "help": f.metadata["help"]}
            spelled = [f"--{name.replace('_', '-')}"] if row.pop("flag", False) else []
            kind = Annotated[hint.kinds()[f.name], typer.Option(*spelled, **row)]
            default = None if f.default == () else f.default  # a list that is not given
            parameters.append(inspect.Parameter(name, p.KEYWORD_ONLY, default=default, annotation=kind))

    @wraps(command)
    def run(**given: Any) -> None:
        for parameter, (of, rows) in classes.items():
            values = {f.name: given.pop(name) for name, f in rows.items()}
            lists = {f.name: tuple(values[f.name] or ()) for f in rows.values() if f.default == ()}
            given[parameter] = of(**values | lists)
        command(**given)

    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {p.name: p.annotation for p in parameters}
    return run  # type: ignore[return-value]


def teller(*, quiet: bool = False, highlight: bool = False) -> Console:
    """A console for words that may hold names from files: square brackets in them are no markup."""
    return Console(quiet=quiet, highlight=highlight, markup=False)


def print_screen(screen: Screen, lines: int | None = None, *, quiet: bool = False) -> int:
    """In at most these lines (None: all of a screen), at most `COLUMNS` wide; as wide where it is no terminal. Returns
    how many it took."""
    from bayes_aero.report.screen import LINES

    wide = Console()
    width = min(wide.width, COLUMNS) if wide.is_terminal else COLUMNS
    console = Console(quiet=quiet, highlight=False, markup=False, width=width)
    console.print(grid := screen.terminal(console, lines or LINES))
    return len(console.render_lines(grid))


@contextmanager
def bar(first: str, over: float = 30.0, spent: dict[str, float] | None = None) -> Iterator[Progress]:
    """A bar with the stage, its time and what is left by the last `over` seconds; silence without a terminal. `spent`
    gets the seconds of each stage."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with ProgressBar(
        *columns, console=console, transient=True, disable=not console.is_terminal, speed_estimate_period=over
    ) as shown:
        task, stage, begun = shown.add_task(first, total=1.0), first, time.perf_counter()

        def tell(text: str, share: float) -> None:
            nonlocal stage, begun
            if spent is not None and text != stage:
                now = time.perf_counter()
                spent[stage] = spent.get(stage, 0.0) + now - begun
                stage, begun = text, now
            if share < shown.tasks[0].completed:  # the next stage; a finished task's clock would stand still for good
                shown.reset(task)
            shown.update(task, description=text, completed=share)

        yield tell
        tell("", 1.0)


def loading() -> AbstractContextManager[Progress]:
    """While the numerical libraries are imported, which takes seconds."""
    return bar("loading libraries")


def card_and_records(records: Sequence[Path], reading: ReadingOptions) -> tuple[Card, list[FlightRecord]]:
    """What a command is given, read before anything that takes seconds to load: a mistake is reported at once."""
    from bayes_aero.flight.reading import present, read_records

    for path in records:
        present(path)
    with loading():
        from bayes_aero.flight.card import read_card
    card, how = read_card(reading.model), {"resample": reading.resample, "split": reading.split}
    return card, read_records(records, card.channels, segments=card.segments, **how)


def check_result(given: str) -> None:
    """Refuse what is neither a finished result nor a card, before the libraries are loaded."""
    from bayes_aero.jobs.store import read_result, result_file

    file = result_file(given)
    if file is not None:
        read_result(file)


def print_json(content: Mapping[str, Any]) -> None:
    """One JSON document on stdout; a number that does not exist (NaN, infinity) is null."""
    from bayes_aero.jobs.store import as_json

    sys.stdout.write(as_json(dict(content)))


def print_failures(console: Console, failures: Sequence[str]) -> None:
    for sentence in failures:
        console.print(f"✗ {sentence}", style="red", highlight=False, soft_wrap=True)


def exit_in_doubt(agreement: Consistency | None, health: Sequence[HealthFinding], *, corrects: bool) -> None:
    """Leave with `DOUBT` where a channel is faulty or sensors disagree, but for known errors that were corrected."""
    explained = corrects and agreement is not None and agreement.agreement == "disagree_explained"
    disagrees = agreement is not None and agreement.disagrees and not explained
    if disagrees or any(finding.grave for finding in health):
        raise typer.Exit(DOUBT)


def conclude(
    screen: Screen | None,
    outcome: Any,
    document: Path,
    written: Sequence[str] = (),
    *,
    verbose: bool,
    json: bool,
    corrects: bool = False,
    compared: bool = True,
    failures: Sequence[str] | None = None,
    failed: bool = False,
    doubtful: bool = False,
) -> None:
    """Print the screen (None: it was printed), what was `written` and, if `verbose`, the text of the page; or the JSON
    `document`. Then leave with the code. `corrects`: known errors of sensors were taken out; `compared`: the sensors
    were; `failed`: the result is of no use; `doubtful`: it is in doubt whatever the records are."""
    if json:
        typer.echo(document.read_text(encoding="utf-8"), nl=False)
    else:
        if screen is not None:
            print_screen(screen)
        for line in (*written, f"Results are in {document.parent}"):
            teller().print(line, soft_wrap=True)
        pages = document.with_suffix(".txt"), document.with_name("report.txt")
        for page in (page for page in pages if verbose and page.exists()):
            typer.echo(f"{ALL}{page.read_text(encoding='utf-8')}", nl=False)
    if failed or (outcome.failures if failures is None else failures):
        raise typer.Exit(FAILED)
    if doubtful:
        raise typer.Exit(DOUBT)
    exit_in_doubt(outcome.consistency if compared else None, outcome.health, corrects=corrects)


class InterruptionError(Exception):
    """Ctrl-C, with what is kept and how to continue."""


@contextmanager
def interruptible(resume: Callable[[], str]) -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt:
        raise InterruptionError(resume()) from None


@contextmanager
def working(out: Path, timings: bool, first: str = "reading") -> Iterator[Progress]:
    """The bar of a command that writes stage by stage into `out`; Ctrl-C says what is kept. With `timings` the seconds
    of each stage are printed."""
    began = time.time() - 1.0  # file systems round times

    def resume() -> str:
        files = [path.name for path in sorted(out.glob("[!.]*")) if path.stat().st_mtime >= began]
        if not files:
            return f"no stage had finished, so {out} holds nothing new; give the same command to start again"
        return f"{out} has the stages that had finished ({', '.join(files)}); the same command repeats all stages"

    spent: dict[str, float] = {}
    with interruptible(resume), bar(first, spent=spent) as tell:
        yield tell
    for stage, seconds in spent.items() if timings else ():
        print(f"{seconds:7.1f} s  {stage}", file=sys.stderr)


# --- Options of the command line that are gone: one row each, told before the command line is parsed.

GONE: tuple[tuple[str, str, str], ...] = (
    ("diagnose", "--predictors/--no-predictors", "predictors are no longer compared; see --no-test-points"),
    ("fly", "--drift", "run diagnose, which says whether a parameter changed, when and by how much"),
    ("identify", "--approximate-gp", "processes are exact; give parts (FILE@FROM:TO) or a longer --resample"),
    ("run", "--memory", "each of the workers has an equal share; give fewer --workers for more"),
    ("run", "--verify", "run the study again with another --out and compare the two summary.csv"),
    ("simulate", "--page/--no-page", "run check on the record with --out for a page of it"),
    ("effects", "--out", "use --json > effects.json"),
)
"""Command, option (every spelling, "--one/--no-one"), and the rest of the sentence: what to use instead."""


def refuse_gone(arguments: Sequence[str]) -> None:
    """Raise `InputError` for an option that is gone, with what to use instead; `arguments`: the command first."""
    command, *rest = arguments or ("",)
    options = rest[: rest.index("--")] if "--" in rest else rest  # behind it are names of files
    spelled = [argument.partition("=")[0] for argument in options]
    for of, option, instead in GONE:
        for given in option.split("/"):
            if of == command and given in spelled:
                raise InputError(f"{given} of {command} is gone: {instead}")
