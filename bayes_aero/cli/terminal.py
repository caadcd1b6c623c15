"""What all commands share: exit codes, the bar, JSON on stdout, choices of options, and options that are gone."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as ProgressBar

from bayes_aero.errors import InputError
from bayes_aero.progress import Progress

if TYPE_CHECKING:
    from bayes_aero.flight.agreement import Consistency
    from bayes_aero.flight.card.card import Card
    from bayes_aero.flight.health import HealthFinding
    from bayes_aero.flight.record import FlightRecord


FAILED = 1
BAD_INPUT = 2
DOUBT = 3  # done and written, but sensors disagree or a channel is faulty
INTERRUPTED = 130

SUFFIXES = ".csv .asc .mat .xlsx .mf4 .ulg .bin .parquet .nc"
RECORDS = f"Flight records ({SUFFIXES}), or parts of them, FILE@FROM:TO in seconds"

JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON and nothing else on stdout.")]
ModelOption = Annotated[str, typer.Option(help="Card: a .toml file, or a shipped one by name.", metavar="CARD")]
SeedOption = Annotated[
    int, typer.Option(min=0, max=2**32 - 1, help="Same seed, same command, same machine: same numbers.")
]
ResampleOption = Annotated[
    float | None,
    typer.Option(help="Interpolate records with uneven or several rates to this time step in s."),
]
FrequencyOption = Annotated[
    tuple[float, float] | None,
    typer.Option(
        metavar="LOW HIGH", help="Hz: fit in the frequency domain, too, in this band, where bias and drift drop out."
    ),
]
SplitOption = Annotated[bool, typer.Option("--split", help="Gaps in time divide a file into manoeuvres.")]


def teller(*, quiet: bool = False, highlight: bool = False) -> Console:
    """A console for words that may hold names from files: square brackets in them are no markup."""
    return Console(quiet=quiet, highlight=highlight, markup=False)


@contextmanager
def bar(first: str, over: float = 30.0) -> Iterator[Progress]:
    """A bar with the time left on the terminal, silence elsewhere; tell it a stage and the share of it that is done.

    Both times are the stage's; what is left is estimated from the last `over` seconds.
    """
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with ProgressBar(
        *columns, console=console, transient=True, disable=not console.is_terminal, speed_estimate_period=over
    ) as shown:
        task = shown.add_task(first, total=1.0)

        def tell(text: str, share: float) -> None:
            if share < shown.tasks[0].completed:  # the next stage; a finished task's clock would stand still for good
                shown.reset(task)
            shown.update(task, description=text, completed=share)

        yield tell


@contextmanager
def loading() -> Iterator[None]:
    """While the numerical libraries are imported, which takes seconds."""
    with bar("loading libraries"):
        yield


def card_and_records(
    model: str, records: Sequence[Path], resample: float | None, split: bool
) -> tuple[Card, list[FlightRecord]]:
    """What a command is given, read before anything that takes seconds to load: a mistake is reported at once."""
    from bayes_aero.flight.reading.read_record import present, read_records

    for path in records:
        present(path)
    with loading():
        from bayes_aero.flight.card.card import read_card
    card = read_card(model)
    return card, read_records(records, card.channels, resample=resample, segments=card.segments, split=split)


def print_json(content: Mapping[str, Any]) -> None:
    """One JSON document on stdout; a number that does not exist (NaN, infinity) is null."""
    from bayes_aero.jobs.provenance import as_json

    sys.stdout.write(as_json(dict(content)))


def print_doubts(
    console: Console, agreement: Consistency | None, health: Sequence[HealthFinding], *, corrects: bool
) -> None:
    """Faulty channels and whether the sensors agree: the first things that are printed.

    `corrects`: whether the command takes known errors of sensors out by itself.
    """
    from bayes_aero.report.text.check import consistency_sentences

    for finding in health:
        console.print(f"! {finding.sentence}", highlight=False)
    if agreement is not None:
        first, *rest = consistency_sentences(agreement, corrects=corrects)
        console.print(f"{'!' if agreement.disagrees else '•'} {first}", highlight=False)
        for sentence in rest:
            console.print(f"• {sentence}", highlight=False)


def print_failures(console: Console, failures: Sequence[str]) -> None:
    """Parts of a job that failed unexpectedly."""
    for sentence in failures:
        console.print(f"✗ {sentence}", style="red", highlight=False, soft_wrap=True)


def exit_if_failed(failures: Sequence[str]) -> None:
    """Leave with `FAILED` where a part of the job failed unexpectedly; what the others found is written."""
    if failures:
        raise typer.Exit(FAILED)


def exit_in_doubt(agreement: Consistency | None, health: Sequence[HealthFinding], *, corrects: bool) -> None:
    """Leave with `DOUBT` where a channel is faulty or sensors disagree, but for known errors that were corrected."""
    disagrees = agreement is not None and agreement.disagrees
    if disagrees and corrects and agreement is not None and agreement.agreement == "disagree_explained":
        disagrees = False
    if disagrees or any(finding.grave for finding in health):
        raise typer.Exit(DOUBT)


class InterruptionError(Exception):
    """Ctrl-C, with what is kept and how to continue."""


@contextmanager
def interruptible(resume: Callable[[], str]) -> Iterator[None]:
    """Report at Ctrl-C what is kept and how to continue."""
    try:
        yield
    except KeyboardInterrupt:
        raise InterruptionError(resume()) from None


def kept_stages(out: Path) -> Callable[[], str]:
    """What a command that writes stage by stage has left in `out` since this call."""
    began = time.time() - 1.0  # file systems round times

    def told() -> str:
        written = [
            path.name
            for path in (sorted(out.iterdir()) if out.is_dir() else [])
            if path.suffix != ".part" and not path.name.startswith(".") and path.stat().st_mtime >= began
        ]
        if not written:
            return f"no stage had finished, so {out} holds nothing new; give the same command to start again"
        return (
            f"the stages that had finished are in {out} ({', '.join(written)}) and can be used as they are; "
            "the same command repeats all stages"
        )

    return told


# --- Choices of options, written out so that --help need not import the numerical libraries; a test compares them.


class NoiseModel(StrEnum):
    """Noise models of the posterior: `model.noise.Colour`."""

    WHITE = "white"
    AR1 = "ar1"
    BUFFET_AR1 = "buffet-ar1"


class Coefficients(StrEnum):
    """How coefficients are formed: `model.observations.Forming`."""

    MATCHED = "matched"
    PUBLISHED = "published"


class InitialState(StrEnum):
    """Where a manoeuvre begins: `jobs.options.INITIAL_STATES`."""

    FREE = "free"
    FIXED = "fixed"


class Inputs(StrEnum):
    """Inputs between samples: `jobs.options.INPUTS`."""

    LINEAR = "linear"
    HELD = "held"


class Split(StrEnum):
    """How data are held back to test the Gaussian process: `inference.splits.SplitKind`."""

    RANDOM = "random"
    BLOCK = "block"
    MANOEUVRE = "manoeuvre"


class SimulatedNoise(StrEnum):
    """Noise of a simulated record: `simulate.request.NOISES`."""

    NONE = "none"
    WHITE = "white"
    AR1 = "ar1"
    BUFFET = "buffet"


class Manoeuvre(StrEnum):
    """What is flown: `simulate.request.MANOEUVRES`."""

    RANDOM_STALL = "random_stall"
    SLOW_STALL = "slow_stall"
    ELEVATOR_DOUBLET = "elevator_doublet"
    ELEVATOR_3211 = "elevator_3211"
    MULTISINE = "multisine"
    THRUST_STEPS = "thrust_steps"
    SPEED_CHANGE = "speed_change"
    SIDESLIP = "sideslip"
    BANK_TO_BANK = "bank_to_bank"
    STABILIZER_STEPS = "stabilizer_steps"
    AILERON_DOUBLET = "aileron_doublet"
    RUDDER_DOUBLET = "rudder_doublet"
    STALL_WITH_BANK = "stall_with_bank"
    ENGINE_STEPS = "engine_steps"


class ExportForm(StrEnum):
    """Forms of an exported model: `jobs.handover.export.FORMS`."""

    JSBSIM = "jsbsim"
    FMU = "fmu"
    TABLES = "tables"


# --- Options of the command line that are gone: one row each, told before the command line is parsed.

GONE: tuple[tuple[str, str, str], ...] = (
    (
        "diagnose",
        "--predictors/--no-predictors",
        "predictors are no longer compared; use --no-test-points to leave out the manoeuvres that decide what is open",
    ),
    ("fly", "--drift", "run diagnose, which says whether a parameter changed, when and by how much"),
    (
        "identify",
        "--approximate-gp",
        "Gaussian processes are exact; give shorter parts of the records (FILE@FROM:TO) or a longer --resample",
    ),
    ("run", "--verify", "run the study again with another --out and compare the two summary.csv"),
)
"""Command, option (every spelling, "--one/--no-one"), and the rest of the sentence: what to use instead."""


def refuse_gone(arguments: Sequence[str]) -> None:
    """Refuse an option that is gone, with what to use instead.

    Args:
        arguments: of the program, the command first.

    Raises:
        InputError: one of them is gone.
    """
    command, *rest = arguments or ("",)
    options = rest[: rest.index("--")] if "--" in rest else rest  # behind it are names of files
    spelled = [argument.partition("=")[0] for argument in options]
    for of, option, instead in GONE:
        for given in option.split("/"):
            if of == command and given in spelled:
                raise InputError(f"{given} of {command} is gone: {instead}")
