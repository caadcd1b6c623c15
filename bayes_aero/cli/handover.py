"""bayes-aero export, open and qualify: what is done with a finished result."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayes_aero.cli import terminal
from bayes_aero.jobs.options import ExportForm, QualifyOptions


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
    model: terminal.ResultCardOption = None,
    draws: Annotated[int, typer.Option(min=0, help="Draws of the parameters to write, of their posterior.")] = 0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the draws.")] = 0,
    json: terminal.JsonOption = False,
) -> None:
    """Write the identified aerodynamic model for another simulator.

    All effects of the aircraft are exported, sensor errors and gusts are not; the terminal and README.txt say which.

    Example: bayes-aero export results --to jsbsim
    """
    terminal.check_result(result)
    with terminal.loading():
        from bayes_aero.jobs.export import export as run

        folder, facts = run(result, to, out=out, card=model, draws=draws, seed=seed)
    if json:
        terminal.print_json(facts | {"folder": str(folder)})
    sentences = [*facts["sources"], *facts["validity"], *facts["left_out"]]
    if facts["draws"] is not None:
        sentences.append(f"{facts['draws']['count']} draws: {facts['draws']['origin']}.")
    sentences.append(f"The model is in {folder}: {', '.join(facts['files'])}. README.txt says how to use it.")
    for sentence in sentences:
        terminal.teller(quiet=json).print(sentence, soft_wrap=True)


def open(
    result: Annotated[
        str, typer.Argument(help="Folder (or JSON file) that identify, fly or diagnose wrote.", metavar="DIR")
    ],
    records: Annotated[
        list[Path] | None, typer.Option(help="Folder of the records, where they have moved; may be repeated.")
    ] = None,
    model: terminal.ResultCardOption = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port on this machine; 0: any free one.")] = 0,
    browser: Annotated[bool, typer.Option(help="--no-browser: print the address only.")] = True,
) -> None:
    """Look at a finished result on a local page: sliders fly the manoeuvres again at once.

    The page is served to this machine alone (127.0.0.1) and asks nothing of a network. Ctrl-C ends it.

    Example: bayes-aero open results
    """
    terminal.check_result(result)
    with terminal.loading():
        from bayes_aero.explore.opened import open_result
        from bayes_aero.explore.page import page_of
        from bayes_aero.explore.server import PageServer
        from bayes_aero.explore.simulator import Simulator

    with terminal.bar("reading") as tell:
        simulator = Simulator(open_result(result, model, records or ()))
        server = PageServer(page_of(simulator), port)
        tell("compiling", 0.5)
        simulator.result(0)
    for sentence in simulator.opened.doubts:
        terminal.teller().print(f"! {sentence}", soft_wrap=True)
    terminal.teller().print(f"{simulator.opened.title} is open at {server.url} - Ctrl-C ends it.", soft_wrap=True)
    server.serve(browser=browser)


@terminal.with_options
def qualify(
    result: Annotated[
        str,
        typer.Argument(help="Folder (or JSON file) that fly, diagnose or identify wrote.", metavar="RESULT"),
    ],
    options: QualifyOptions,
    records: Annotated[
        list[Path] | None, typer.Argument(help=f"Further tests: records that were not fitted. {terminal.RECORDS}.")
    ] = None,
    out: terminal.OutOption = Path("qualification"),
    json: terminal.JsonOption = False,
) -> None:
    """How probably the simulation passes each tolerance of the card: in the manoeuvres flown, and in the next flight.

    Parameters, errors of the model's structure and gusts are counted. Writes a page for an evaluator to sign. Exit code
    0, whatever the verdict; 3: the records are in doubt.

    Example: bayes-aero qualify trajectories --out qualification
    """
    from bayes_aero.flight.reading import present

    for path in (*(records or ()), *options.fitted):
        present(path)
    terminal.check_result(result)
    with terminal.loading():
        from bayes_aero.jobs.qualify import RESULTS, qualify_result
        from bayes_aero.report.pages.qualification import further_sentences, sentences, verdict_sentence, verdict_table

    console = terminal.teller(quiet=json)
    with terminal.working(out) as tell:
        found, failures = qualify_result(result, tuple(records or ()), options, out=out, progress=tell)

    def show() -> None:
        console.print(verdict_sentence(found), soft_wrap=True)
        console.print(verdict_table(found).terminal())
        origins = [f"{name}: {text}" for name, text in found.origins.items()]
        terminal.print_lines(console, (*sentences(found), *further_sentences(found.further), *origins))
        console.print(f"Results are in {out}; qualification.html is to be signed or refused", soft_wrap=True)

    terminal.conclude(console, found, show, json=out / RESULTS if json else None, failures=failures)
