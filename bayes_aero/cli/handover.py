"""bayes-aero export, open and qualify: what is done with a finished result."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayes_aero.cli.terminal import (
    RECORDS,
    ExportForm,
    JsonOption,
    SeedOption,
    bar,
    exit_if_failed,
    exit_in_doubt,
    interruptible,
    kept_stages,
    loading,
    print_doubts,
    print_failures,
    print_json,
    teller,
)


def export(
    result: Annotated[
        str,
        typer.Argument(
            help="Folder (or JSON file) that identify, fly or diagnose wrote, or a card that states every value.",
            metavar="MODEL",
        ),
    ],
    to: Annotated[
        ExportForm,
        typer.Option(help="jsbsim: aerodynamics, states and a body; fmu: FMI 2.0; tables: NetCDF and CSV."),
    ],
    out: Annotated[Path | None, typer.Option(help="Folder to make; default: NAME_FORM, here.")] = None,
    model: Annotated[
        str | None, typer.Option(help="The card of the result, where it is not found by itself.", metavar="CARD")
    ] = None,
    draws: Annotated[int, typer.Option(min=0, help="Draws of the parameters to write, of their posterior.")] = 0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the draws.")] = 0,
    json: JsonOption = False,
) -> None:
    """Write the identified aerodynamic model for another simulator.

    All effects of the aircraft are exported, sensor errors and gusts are not; the terminal and README.txt say which.

    Example: bayes-aero export results --to jsbsim
    """
    from bayes_aero.jobs.io.result_file import read_result, result_file

    file = result_file(result)
    if file is not None:
        read_result(file)
    with loading():
        from bayes_aero.jobs.export import export as run

        folder, facts = run(result, to.value, out=out, card=model, draws=draws, seed=seed)
    if json:
        print_json(facts | {"folder": str(folder)})
        return
    console = teller()
    for sentence in (*facts["sources"], *facts["validity"], *facts["left_out"]):
        console.print(sentence, soft_wrap=True)
    if facts["draws"] is not None:
        console.print(f"{facts['draws']['count']} draws: {facts['draws']['origin']}.", soft_wrap=True)
    console.print(
        f"The model is in {folder}: {', '.join(facts['files'])}. README.txt says how to use it.", soft_wrap=True
    )


# --- bayes-aero open.


def open(
    result: Annotated[
        str, typer.Argument(help="Folder (or JSON file) that identify, fly or diagnose wrote.", metavar="DIR")
    ],
    records: Annotated[
        list[Path] | None, typer.Option(help="Folder of the records, where they have moved; may be repeated.")
    ] = None,
    model: Annotated[
        str | None, typer.Option(help="The card of the result, where it is not found by itself.", metavar="CARD")
    ] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port on this machine; 0: any free one.")] = 0,
    browser: Annotated[bool, typer.Option(help="--no-browser: print the address only.")] = True,
) -> None:
    """Look at a finished result on a local page: sliders fly the manoeuvres again at once.

    The page is served to this machine alone (127.0.0.1) and asks nothing of a network. Ctrl-C ends it.

    Example: bayes-aero open results
    """
    from bayes_aero.jobs.io.result_file import read_result, result_file

    file = result_file(result)
    if file is not None:
        read_result(file)
    with loading():
        from bayes_aero.explore.opened import open_result
        from bayes_aero.explore.page import page_of
        from bayes_aero.explore.server import PageServer
        from bayes_aero.explore.simulator import Simulator

    with bar("reading") as tell:
        simulator = Simulator(open_result(result, model, records or ()))
        server = PageServer(page_of(simulator), port)
        tell("compiling", 0.5)
        simulator.result(0)
    for sentence in simulator.opened.doubts:
        teller().print(f"! {sentence}", soft_wrap=True)
    told = f"{simulator.opened.title} is open at {server.url} - Ctrl-C ends it."
    teller().print(told, soft_wrap=True)
    server.serve(browser=browser)


# --- bayes-aero qualify.


def qualify(
    result: Annotated[
        str,
        typer.Argument(help="Folder (or JSON file) that fly, diagnose or identify wrote.", metavar="RESULT"),
    ],
    records: Annotated[
        list[Path] | None, typer.Argument(help=f"Further tests: records that were not fitted. {RECORDS}.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("qualification"),
    model: Annotated[
        str | None, typer.Option(help="The card of the result, where it is not found by itself.", metavar="CARD")
    ] = None,
    fitted: Annotated[
        list[Path] | None,
        typer.Option(help="A record of the result, where they are not found by themselves; once for each."),
    ] = None,
    draws: Annotated[int, typer.Option(help="Flights drawn for every test.")] = 400,
    gusts: Annotated[
        float | None,
        typer.Option(help="Intensity of gusts in m/s (standard deviation); default: those that fly has estimated."),
    ] = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """How probably the simulation passes each tolerance of the card: in the manoeuvres flown, and in the next flight.

    Parameters, errors of the model's structure and gusts are counted. Writes a page for an evaluator to sign. Exit code
    0, whatever the verdict; 3: the records are in doubt.

    Example: bayes-aero qualify trajectories --out qualification
    """
    from bayes_aero.flight.reading.read_record import present
    from bayes_aero.jobs.io.result_file import read_result, result_file

    for path in (*(records or ()), *(fitted or ())):
        present(path)
    file = result_file(result)
    if file is not None:
        read_result(file)
    with loading():
        from bayes_aero.jobs.qualify import RESULTS, QualifyOptions, qualify_result
        from bayes_aero.report.qualification import further_sentences, sentences, verdict_sentence, verdict_table

    console = teller(quiet=json)
    options = QualifyOptions(model, tuple(fitted or ()), draws, seed, gusts)
    with interruptible(kept_stages(out)), bar("reading") as tell:
        found, failures = qualify_result(result, tuple(records or ()), options, out=out, progress=tell)
    if json:
        typer.echo((out / RESULTS).read_text(encoding="utf-8"), nl=False)
    print_failures(console, failures)
    print_doubts(console, found.consistency, found.health, corrects=False)
    console.print(verdict_sentence(found), soft_wrap=True)
    console.print(verdict_table(found).terminal())
    for sentence in (
        *sentences(found),
        *further_sentences(found.further),
        *(f"{name}: {text}" for name, text in found.origins.items()),
    ):
        console.print(f"• {sentence}", highlight=False)
    console.print(f"Results are in {out}; qualification.html is to be signed or refused", soft_wrap=True)
    exit_if_failed(failures)
    exit_in_doubt(found.consistency, found.health, corrects=False)
