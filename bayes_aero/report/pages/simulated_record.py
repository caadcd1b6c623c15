"""The page of a simulated record: channels, true parameters, hidden effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.record import FlightRecord
from bayes_aero.parameter import Parameter
from bayes_aero.report.html.page import Page, Table, Text, filled, section
from bayes_aero.report.html.parts import at_a_glance, provenance_blocks, symbols
from bayes_aero.report.pages.check import recorded
from bayes_aero.report.text.phrases import bracket, number, plain_unit, several


def simulated_page(
    record: FlightRecord,
    card: Card,
    truth: Mapping[str, Any],
    parameters: Sequence[Parameter],
) -> Page:
    """The page; `truth` is what stands in the file beside the record, `parameters` are those that were flown."""
    units = {p.name: p.unit for p in parameters}
    hidden = [f"{name} ({_values(values, units)})" for name, values in truth["effects"].items()]
    verdict = f"A simulated record of {record.time[-1] - record.time[0]:.0f} s; " + (
        f"hidden effect: {several(hidden)}." if hidden else "no effect is hidden in it."
    )
    return Page(
        title=f"Simulated record: {record.name}",
        subtitle="A synthetic flight record and its true parameters",
        verdict=verdict,
        lead=(*(Text(note, "warning") for note in truth["notes"]), *recorded([record])),
        sections=filled(
            section("records", "The record at a glance", lambda: at_a_glance([record], card)),
            section(
                "truth", "True parameters", lambda: (_truth(truth, parameters), _noise(truth), _meaning(parameters))
            ),
            section("provenance", "Provenance", lambda: provenance_blocks(truth["provenance"])),
        ),
    )


def _values(values: Mapping[str, float], units: Mapping[str, str]) -> str:
    behind = {name: "" if unit == "1" else f" {plain_unit(unit)}" for name, unit in units.items()}
    return ", ".join(f"{name} = {number(x)}{behind.get(name, ' in SI')}" for name, x in values.items())


def _truth(truth: Mapping[str, Any], parameters: Sequence[Parameter]) -> Table:
    units = {p.name: p.unit for p in parameters}
    asked = {name for values in truth["effects"].values() for name in values}
    rows = tuple(
        (f"{name} {bracket(plain_unit(units.get(name, '1')))}", number(x, 6), "hidden" if name in asked else "")
        for name, x in truth["parameters"].items()
    )
    return Table("True parameters, SI and radians", ("parameter", "value", "remark"), rows, words=(2,)).lean()


def _noise(truth: Mapping[str, Any]) -> Table:
    rows = [(name, number(x)) for name, x in truth["disturbance"].items()]
    units = {name: channel.unit for name, channel in STANDARD_CHANNELS.items()}
    rows += [
        (f"{name} {bracket(plain_unit(units.get(name, '1')))}", number(x)) for name, x in truth["sensor_noise"].items()
    ]
    return Table(
        "Noise: disturbances of the coefficients, and standard deviations of the sensors in SI",
        ("", "value"),
        tuple(rows),
    )


def _meaning(parameters: Sequence[Parameter]):
    return symbols(parameters, [p.name for p in parameters])
