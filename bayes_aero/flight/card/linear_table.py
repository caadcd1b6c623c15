"""The section [linear] of a card: a state-space model in dimensional derivatives.

Every row is a table {parameter = what it multiplies}: a channel, "1" for the constant, or a table of channels with
numbers, `Lda = { aileron_left = 0.5, aileron_right = -0.5 }`. Nothing is parsed but names and numbers.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from bayes_aero.errors import InputError
from bayes_aero.flight.card.table_checks import known_keys, numbers, section

ONE = "1"
"""Stands for the constant among the channels."""


class Term(NamedTuple):
    """parameter x factor x channel, in SI and radians."""

    parameter: str
    channel: str
    factor: float = 1.0


@dataclass(frozen=True)
class LinearCard:
    """Rows of a linear system: the rate of each state, and outputs; that of a state is what the record shows beyond it.

    `delays`: the parameter, s, by which an output is recorded late. `by_manoeuvre`: constants that differ between
    manoeuvres.
    """

    states: tuple[str, ...]
    rates: tuple[tuple[Term, ...], ...]
    outputs: tuple[str, ...] = ()
    readings: tuple[tuple[Term, ...], ...] = ()
    fixed: tuple[tuple[str, float], ...] = ()
    delays: tuple[tuple[str, str], ...] = ()
    by_manoeuvre: tuple[str, ...] = ()

    @property
    def rows(self) -> tuple[tuple[str, tuple[Term, ...]], ...]:
        """Name and terms of every row, rates first."""
        return (*zip(self.states, self.rates, strict=True), *zip(self.outputs, self.readings, strict=True))

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of all parameters, in the order in which the card first writes them."""
        of_rows = (term.parameter for _, row in self.rows for term in row)
        return tuple(dict.fromkeys([*of_rows, *(parameter for _, parameter in self.delays)]))

    @property
    def inputs(self) -> tuple[str, ...]:
        """Channels that it needs beside its states."""
        found = dict.fromkeys(term.channel for _, row in self.rows for term in row)
        return tuple(name for name in found if name != ONE and name not in self.states)


def parse_linear(table: Any, channels: Collection[str], where: str) -> LinearCard:
    """Check [linear]; `channels` are those that the card maps, sums or holds constant."""
    if not isinstance(table, dict):
        raise InputError(f"card {where}: linear must be a section, [linear]")
    known_keys(table, ("states", "rates", "outputs", "fixed", "delays", "by_manoeuvre"), where, "key of [linear]")
    states = table.get("states")
    if not (isinstance(states, list) and states and all(isinstance(name, str) for name in states)):
        raise InputError(f'card {where}: [linear] states must be a list of channels, e.g. ["alpha", "q"]')
    if len(set(states)) < len(states):
        raise InputError(f"card {where}: [linear] states names a state twice")
    _mapped(states, channels, f"{where}: [linear] states")
    rates, outputs = section(table, "rates", where), section(table, "outputs", where)
    known_keys(rates, tuple(states), where, "state of [linear.rates]")
    for name in states:
        if name not in rates:
            raise InputError(f"card {where}: [linear.rates.{name}] is missing; every state needs its rate")
    _mapped(outputs, channels, f"{where}: [linear.outputs]")
    found = LinearCard(
        states=tuple(states),
        rates=tuple(_row(rates[name], channels, f"{where}: [linear.rates.{name}]") for name in states),
        outputs=tuple(outputs),
        readings=tuple(_row(row, channels, f"{where}: [linear.outputs.{name}]") for name, row in outputs.items()),
        fixed=tuple(numbers(table.get("fixed", {}), f"{where}: [linear] fixed").items()),
    )
    for name, row in zip(found.outputs, found.readings, strict=True):
        if name in states and any(term.channel != ONE for term in row):
            raise InputError(
                f"card {where}: [linear.outputs.{name}] is a state, which is an output already; it may only have a "
                'bias, by = "1"'
            )
    own, fixed = _by_manoeuvre(table.get("by_manoeuvre", []), found, where), dict(found.fixed)
    found = replace(found, delays=_delays(section(table, "delays", where), found, where), by_manoeuvre=own)
    if both := [name for name in own if name in fixed]:
        raise InputError(
            f"card {where}: [linear] {both[0]} is fixed and differs between manoeuvres; drop one of the two"
        )
    for name, _ in found.fixed:
        if name not in found.parameters:
            raise InputError(
                f"card {where}: [linear.fixed] {name} is a parameter of no row; drop it or correct its name"
            )
    return found


def _by_manoeuvre(given: Any, found: LinearCard, where: str) -> tuple[str, ...]:
    if not (isinstance(given, list) and all(isinstance(name, str) for name in given)):
        raise InputError(f'card {where}: [linear] by_manoeuvre must be a list of constants, e.g. ["L0", "N0"]')
    for name in given:
        terms = [term for _, row in found.rows for term in row if term.parameter == name]
        if not terms or any(term.channel != ONE for term in terms):
            raise InputError(
                f'card {where}: [linear] by_manoeuvre has {name}, which is no constant; only parameters of "1" can '
                "differ between manoeuvres"
            )
    return tuple(dict.fromkeys(given))


def _delays(table: Mapping[str, Any], found: LinearCard, where: str) -> tuple[tuple[str, str], ...]:
    known_keys(table, (*found.states, *found.outputs), where, "output of [linear.delays]")
    for output, parameter in table.items():
        if not isinstance(parameter, str) or parameter in found.parameters:
            raise InputError(f"card {where}: [linear.delays] {output} must be the name of a parameter of no row")
    return tuple(table.items())


def _row(table: Any, channels: Collection[str], where: str) -> tuple[Term, ...]:
    if not (isinstance(table, dict) and table):
        raise InputError(f'card {where} must be a table of parameters and what they multiply, e.g. Zalpha = "alpha"')
    terms = [
        Term(parameter, channel, factor)
        for parameter, given in table.items()
        for channel, factor in _multiplied(given, f"{where} {parameter}").items()
    ]
    _mapped([term.channel for term in terms if term.channel != ONE], channels, where)
    return tuple(terms)


def _multiplied(given: Any, where: str) -> Mapping[str, float]:
    if isinstance(given, str):
        return {given: 1.0}
    if isinstance(given, dict) and given:
        return numbers(given, where)
    raise InputError(f'card {where} is {given!r}; write the channel it multiplies, e.g. "alpha", or "1" for a constant')


def _mapped(names: Collection[str], channels: Collection[str], where: str) -> None:
    for name in names:
        if name not in channels:
            raise InputError(f"card {where} uses {name}, which [channels] does not map")
