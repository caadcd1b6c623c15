"""bayes-aero open."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayes_aero.cli.terminal import bar, loading, teller


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
    from bayes_aero.jobs.handover.result_file import read_result, result_file

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
