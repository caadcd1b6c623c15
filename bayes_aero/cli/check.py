"""bayes-aero check."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from bayes_aero.cli.terminal import (
    FAILED,
    JsonOption,
    ModelOption,
    ResampleOption,
    SeedOption,
    bar,
    interruptible,
    print_json,
    teller,
)

if TYPE_CHECKING:
    from bayes_aero.flight.inspection import RecordReport
    from bayes_aero.studies.check import CheckReport


def check(
    records: Annotated[list[Path], typer.Argument(help="Flight records (.asc .csv .mat .parquet .nc).")],
    model: ModelOption = "attas",
    resample: ResampleOption = None,
    sensors: Annotated[bool, typer.Option(help="Check the sensors against each other along the flight path.")] = True,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Check records against a card: channels, units, gaps, what they can test, whether the sensors agree.

    Nothing aerodynamic is fitted. Exit code 0: usable; 1: not, with the reasons.

    Example: bayes-aero check qst01.asc qst02.asc --model attas
    """
    from bayes_aero.flight.card import read_card
    from bayes_aero.studies.check import check_records, check_results

    card = read_card(model)
    with interruptible(lambda: "check writes nothing; give the same command again"), bar("reading") as tell:
        report = check_records(records, card, resample=resample, sensors=sensors, seed=seed, progress=tell)
    if json:
        print_json(check_results(report))
    else:
        _tell(teller(), report)
    if not report.usable:
        raise typer.Exit(FAILED)


def _tell(console: Console, report: CheckReport) -> None:
    for record in report.records:
        _tell_record(console, record)
    for name, value in report.card.constants.items():
        console.print(f"constant from the card: {name} = {value:g} (SI)")
    if report.card.derived:
        console.print(f"formed from the altitude, in a standard atmosphere: {', '.join(report.card.derived)}")
    for name, parts in report.card.sums.items():
        console.print(f"sum from the card: {name} = {' + '.join(parts)}")
    for name, why in report.uses.items():
        console.print(f"{name}: possible" if not why else f"{name}: not possible, {why}")
    reasons: dict[str, list[str]] = {}
    for name, why in report.not_testable.items():
        reasons.setdefault(why, []).append(name)
    for why, names in reasons.items():
        console.print(f"not testable, for {why}: {', '.join(names)}")
    _tell_sensors(console, report)
    for caution in report.cautions:
        console.print(f"! {caution}", style="yellow")
    word, colour = ("Usable.", "green") if report.usable else ("Not usable as it is.", "red")
    console.print(word, style=f"bold {colour}")


def _tell_record(console: Console, r: RecordReport) -> None:
    rate = f"{1.0 / r.dt:.4g} Hz" if r.dt > 0.0 else "no sampling rate"
    console.print(r.path, style="bold", end="", soft_wrap=True)
    console.print(f": {r.samples} samples, {r.duration:.6g} s, {rate}", soft_wrap=True)
    if r.gaps or r.uneven:
        console.print(f"{r.gaps} gaps, {r.uneven} uneven steps")
    table = Table(box=SIMPLE_HEAD, pad_edge=False, show_edge=False, padding=(0, 1, 0, 0))
    for heading in ("channel", "taken from", "unit → inside", "range in the file"):
        table.add_column(heading, no_wrap=heading != "taken from")
    table.add_column("")
    for c in r.channels:
        unit = c.unit if c.unit == c.si else f"{c.unit} → {c.si}"
        remarks = [*(["sign turned"] if c.sign < 0 else []), *([] if c.moves else ["does not move"])]
        table.add_row(c.name, c.place, unit, f"{c.lowest:.5g} to {c.highest:.5g}", ", ".join(remarks))
    console.print(table)
    if r.missing:
        console.print(f"on the card, not in the file (not required): {', '.join(r.missing)}")
    if r.unused:
        console.print(f"in the file, not on the card: {', '.join(r.unused)}")
    for problem in r.problems:
        console.print(f"✗ {problem}", style="red")


def _tell_sensors(console: Console, report: CheckReport) -> None:
    from bayes_aero.report.style import for_people

    s = report.sensors
    if s.note:
        console.print(f"Sensors were not checked against each other: {s.note}.")
        return
    if not s.errors:
        console.print("The sensors agree with each other along the flight path.")
    else:
        console.print("Along the flight path the sensors disagree; diagnose takes this into account:")
    for name, error in s.errors.items():
        sizes = []
        for parameter, size in error["parameters"].items():
            unit, factor = for_people(size["unit"])
            behind = "" if unit == "1" else f" {unit}"
            sizes.append(f"{parameter} {factor * size['mean']:.3g} ± {factor * size['sd']:.2g}{behind}")
        faint = " (too small to be worth a name)" if error["minor"] else ""
        console.print(f"  {name}: {error['claim']} {', '.join(sizes)}{faint}")
    units = {"airspeed": "m/s", "alpha": "rad", "theta": "rad", "altitude": "m"}
    left = []
    for name, (before, after) in s.rms.items():
        unit, factor = for_people(units[name])
        change = f"{factor * before:.3g}" if not s.errors else f"{factor * before:.3g} → {factor * after:.3g}"
        left.append(f"{name} {change} {unit}")
    console.print(f"  root mean square of what is left: {', '.join(left)}")
