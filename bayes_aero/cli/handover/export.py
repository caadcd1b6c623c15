"""bayes-aero export."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayes_aero.cli.choices import ExportForm
from bayes_aero.cli.terminal import JsonOption, loading, print_json, teller


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
    from bayes_aero.jobs.handover.result_file import read_result, result_file

    file = result_file(result)
    if file is not None:
        read_result(file)
    with loading():
        from bayes_aero.jobs.handover.export import export as run

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
