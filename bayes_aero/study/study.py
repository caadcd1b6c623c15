"""A study file: which records, cards, seeds, splits, noise models and effects are combined into units of work."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from difflib import get_close_matches
from pathlib import Path
from types import UnionType
from typing import Any, Literal, get_args, get_origin

from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card, read_card, read_table, shipped_cards
from bayes_aero.flight.reading import READERS
from bayes_aero.flight.record import is_file, segment_of
from bayes_aero.jobs.catalogue import effect_named, known_effects
from bayes_aero.jobs.options import (
    MAX_SEED,
    DiagnoseOptions,
    FlyOptions,
    IdentifyOptions,
    NoiseName,
    Options,
    ReadingOptions,
    SplitName,
)
from bayes_aero.jobs.store import safe_name
from bayes_aero.model.model import Model

KEYS = (
    "title", "task", "records", "one_by_one", "cards", "seeds", "splits", "noise", "effects", "options",
)  # fmt: skip
TASKS: dict[str, type[Options]] = {"identify": IdentifyOptions, "diagnose": DiagnoseOptions, "fly": FlyOptions}
OPTIONS: dict[str, dict[str, Any]] = {
    task: {n: kind for of in (options, ReadingOptions) for n, kind in of.kinds().items() if n not in of.APART}
    for task, options in TASKS.items()
}
"""Kind of each option of a task; seeds, and of identify noise and split, are lists of the study instead."""
MAX_UNITS = 100_000
MAX_NAME_LENGTH = 90  # characters of a unit's name before its hash


@dataclass(frozen=True)
class Unit:
    """One job as plain data, which can be sent to another process as JSON.

    `records` and `card` are absolute paths; `shown` are the records relative to the study's folder. The identity of the
    unit consists of `shown` and everything else except the absolute paths.
    """

    name: str
    task: str
    records: tuple[str, ...]
    shown: tuple[str, ...]
    card: str
    card_name: str
    seed: int
    split: str | None
    noise: str | None
    effects: tuple[str, ...]
    options: Mapping[str, Any] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """A dictionary that `of_json` reads back."""
        return json.loads(json.dumps(asdict(self)))

    @classmethod
    def of_json(cls, given: Mapping[str, Any]) -> Unit:
        """The unit that `as_json` wrote."""
        lists = {key: tuple(given[key]) for key in ("records", "shown", "effects")}
        return cls(**{**given, **lists})

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of the unit, without the paths of a machine."""
        own = {key: value for key, value in self.as_json().items() if key not in ("name", "shown", "card_name")}
        own |= {"records": list(self.shown), "card": self.card_name}
        return {key: value for key, value in own.items() if value is not None}


@dataclass(frozen=True)
class Study:
    """A study file with its units, in the order in which they are listed."""

    path: Path
    sha256: str
    title: str
    task: str
    units: tuple[Unit, ...]


def read_study(path: Path, *, trust_effects: bool = False) -> Study:
    """Read and check a study.

    A card that names effect files is refused unless `trust_effects`: they are code, and the user has named only the
    study.
    """
    raw, table = read_table(path, "study")
    where = f"study {path}"
    _known(table, KEYS, where, "key")
    task = table.get("task", "identify")
    if not isinstance(task, str) or task not in OPTIONS:
        raise InputError(f"{where}: task is {task!r}; use one of {', '.join(OPTIONS)}")
    for key in ("splits", "noise"):
        if key in table and task != "identify":
            raise InputError(f"{where}: {key} is of no use to the task {task}; take it out")
    options = checked_options(table.get("options", {}), task, where)
    sets = record_sets(table, path.parent, where)
    cards = study_cards(table.get("cards", ["attas"]), path.parent, where, trust_effects)
    axes: list[list[Any]] = [
        sets,
        list(cards),
        variants(table.get("effects", [[]]), cards, task, where),
        _chosen(table.get("noise", ["buffet-ar1"]), get_args(NoiseName), where, "noise"),
        _chosen(table.get("splits", ["random"]), get_args(SplitName), where, "splits"),
        _list(table.get("seeds", [0]), int, where, "seeds"),
    ]
    if task != "identify":
        axes[3:5] = [None], [None]
    for seed in axes[-1]:
        if not 0 <= seed <= MAX_SEED:
            raise InputError(f"{where}: seeds lists {seed}; a seed lies between 0 and {MAX_SEED}")
    count = math.prod(map(len, axes))
    if count > MAX_UNITS:
        raise InputError(f"{where}: it makes {count} units, more than {MAX_UNITS}; split it into several studies")
    units = tuple(unit_of(task, path.parent, options, choice) for choice in itertools.product(*axes))
    return Study(path, hashlib.sha256(raw).hexdigest(), str(table.get("title", path.stem)), task, units)


def card_of(unit: Unit) -> Card:
    """The card with the unit's effects added to its model."""
    card = read_card(unit.card)
    return replace(card, effects=(*card.effects, *unit.effects)) if unit.effects else card


def unit_of(task: str, folder: Path, options: Mapping[str, Any], choice: Any) -> Unit:
    """The unit of one (records, card, effects, noise, split, seed)."""
    records, card, effects, noise, split, seed = choice
    shown = tuple(Path(os.path.relpath(path, folder)).as_posix() for path in records)
    unit = Unit("", task, tuple(map(str, records)), shown, card[1], card[0], seed, split, noise, effects, dict(options))
    more = f"+{len(records) - 1}" if len(records) > 1 else ""
    parts = [segment_of(records[0]).label + more, Path(card[0]).stem, *effects, noise, split, f"seed{seed}"]
    words = "-".join(re.sub(r"[^A-Za-z0-9+_.]", "_", part) for part in parts if part)
    identity = hashlib.sha256(json.dumps(unit.settings, sort_keys=True).encode()).hexdigest()[:8]
    return replace(unit, name=f"{safe_name(words[:MAX_NAME_LENGTH])}-{identity}")


def _known(table: Mapping[str, Any], known: Sequence[str], where: str, what: str) -> None:
    for key in table:
        if key not in known:
            close = get_close_matches(key, known, n=1)
            hint = f"did you mean {close[0]!r}?" if close else f"known are {', '.join(known)}"
            raise InputError(f"{where}: unknown {what} {key!r}; {hint}")


def _list(given: Any, kind: type, where: str, key: str) -> list[Any]:
    fits = isinstance(given, list) and given and all(isinstance(x, kind) and not isinstance(x, bool) for x in given)
    if not fits:
        words = {str: 'texts, e.g. ["a", "b"]', int: "whole numbers, e.g. [0, 1]", list: 'lists, e.g. [[], ["a"]]'}
        raise InputError(f"{where}: {key} must be a list of {words[kind]}")
    counts = Counter(map(repr, given))
    if len(counts) < len(given):
        raise InputError(f"{where}: {key} lists {counts.most_common(1)[0][0]} twice")
    return given


def record_sets(table: Mapping[str, Any], folder: Path, where: str) -> list[tuple[Path, ...]]:
    """The records of each unit: those of a pattern together, or one by one, in the order of their names."""
    if "records" not in table:
        raise InputError(f'{where}: records are missing; list files or patterns, e.g. records = ["flights/*.csv"]')
    one_by_one = table.get("one_by_one", False)
    if not isinstance(one_by_one, bool):
        raise InputError(f"{where}: one_by_one is {one_by_one!r}; write true or false")
    sets: list[tuple[Path, ...]] = []
    for pattern in _list(table["records"], str, where, "records"):
        if any(c in pattern for c in "*?["):
            start = Path(pattern).anchor
            try:
                relative = str(Path(pattern).relative_to(start)) if start else pattern
                there = (Path(start) if start else folder).glob(relative)
                found = sorted(p.resolve() for p in there if p.is_file() and p.suffix.lower() in READERS)
            except (ValueError, OSError) as reason:
                raise InputError(f"{where}: records {pattern!r} is no pattern of files ({reason})") from None
            if not found:
                what = f"no record matches {pattern!r} in {folder.resolve()}"
                raise InputError(f"{where}: {what}; records end in {', '.join(READERS)}")
        else:
            file = segment_of(folder / pattern).file
            if not is_file(file):
                looked = f"it is looked for in {folder.resolve()}"
                raise InputError(f"{where}: record {pattern!r} does not exist; {looked}")
            found = [Path(str(file.resolve()) + str(folder / pattern).removeprefix(str(file)))]
        sets += [(path,) for path in found] if one_by_one else [tuple(found)]
    return list(dict.fromkeys(sets))


def study_cards(given: Any, folder: Path, where: str, trust_effects: bool) -> dict[tuple[str, str], Card]:
    """Cards by (name as given, absolute path), read once so that a bad one stops the study before it starts."""
    cards = {}
    for name in _list(given, str, where, "cards"):
        path: Path = shipped_cards().get(name) or folder / name
        if not is_file(path):
            known = ", ".join(shipped_cards())
            raise InputError(f"{where}: card {name!r} does not exist; give a .toml file beside the study, or {known}")
        card = read_card(path.resolve())
        if card.effect_files and not trust_effects:
            files = ", ".join(str(file) for file in card.effect_files)
            raise InputError(
                f"{where}: card {name!r} names effect files, which are code and would be run ({files}); read them, "
                "then give --trust-effects"
            )
        cards[name, str(path.resolve())] = card
    return cards


def variants(given: Any, cards: Mapping[Any, Card], task: str, where: str) -> list[tuple[str, ...]]:
    """Effects added to the cards' models; each variant must make a model with each card, or fly its linear system."""
    found = []
    for names in _list(given, list, where, "effects"):
        if not all(isinstance(name, str) for name in names):
            raise InputError(f'{where}: effects must be lists of names of effects, e.g. [[], ["thrust_lag"]]')
        for card in cards.values():
            try:
                for name in names:
                    effect_named(name, known_effects(card))
                if task == "fly" and card.linear is not None and not names:
                    from bayes_aero.dynamics.flight import linear_dynamics

                    linear_dynamics(card)
                else:
                    Model.from_card(replace(card, effects=(*card.effects, *names)))
            except InputError as reason:
                raise InputError(f"{where}: effects {names} with card {card.name}: {reason}") from None
        found.append(tuple(names))
    return found


def _chosen(given: Any, known: Sequence[str], where: str, key: str) -> list[str]:
    for name in _list(given, str, where, key):
        if name not in known:
            raise InputError(f"{where}: {key} lists {name!r}; use {', '.join(known)}")
    return given


def checked_options(given: Any, task: str, where: str) -> dict[str, Any]:
    """The section [options], each of the kind that the task's options have."""
    if not isinstance(given, dict):
        raise InputError(f"{where}: options must be a section, [options]")
    _known(given, tuple(OPTIONS[task]), where, f"option of the task {task}")
    for key, value in given.items():
        kind = OPTIONS[task][key]
        kind = get_args(kind)[0] if get_origin(kind) is UnionType else kind  # what may be left out is optional
        number = isinstance(value, int | float) and not isinstance(value, bool)
        positive = isinstance(value, int | float) and value > 0
        pair = isinstance(value, list) and len(value) == 2 and all(type(x) in (int, float) for x in value)
        bad = ""
        if get_origin(kind) is Literal:
            bad = "" if value in get_args(kind) else f"use one of {', '.join(get_args(kind))}"
        elif kind is str:
            bad = "" if isinstance(value, str) else 'write names in quotes, e.g. "alpha,q"'
        elif kind is bool:
            bad = "" if isinstance(value, bool) else "write a true or false"
        elif get_origin(kind) is tuple:
            bad = "" if pair else "write two frequencies in Hz, e.g. [0.1, 1.5]"
        elif not (number and (kind is float or isinstance(value, int))):
            bad = "write a number"
        elif not positive:
            bad = "it must be positive"
        if bad:
            raise InputError(f"{where}: option {key} is {value!r}; {bad}")
    return dict(given)
