"""The page of one visitor: what is asked in the browser is flown, drawn and answered."""

from __future__ import annotations

import json
import time as clock
from collections.abc import Callable, Mapping
from dataclasses import asdict
from importlib import resources
from typing import Any

import numpy as np
from bokeh.core.properties import String
from bokeh.document import Document
from bokeh.model import DataModel
from bokeh.models import CustomJS

from bayes_aero import __version__
from bayes_aero.errors import InputError, failure
from bayes_aero.explore.asked import Asked, read_asked
from bayes_aero.explore.choice import Choice
from bayes_aero.explore.figures import MOST, MOST_FAN, WORDS, Shared, View, stacked, window_of
from bayes_aero.explore.hand_on import export_chosen
from bayes_aero.explore.scores import gain, scores
from bayes_aero.explore.simulator import DRAWS, Flown, Simulator
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.channel_units import channel_units
from bayes_aero.jobs.handover.export import FORMS
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.text.phrases import axis_label, bracket, for_people

Parts = Mapping[str, np.ndarray]


class Exchange(DataModel):
    """Requests of the browser and answers to it, each as JSON."""

    asked = String("")
    told = String("")


class Page:
    """A document with its state."""

    def __init__(self, simulator: Simulator, document: Document) -> None:
        """Fill the document with panels, and draw the first manoeuvre."""
        self.simulator, self.opened = simulator, simulator.opened
        self.units = {n: c.unit for n, c in STANDARD_CHANNELS.items()} | channel_units(self.opened.card)
        self.tolerances = {name: t.value for name, t in self.opened.card.tolerances.items()}
        self.shared = Shared()
        self.exchange = Exchange()
        self.drawn: tuple[Any, ...] = ()  # manoeuvre and window of the record that is drawn
        self.formed: Parts = {}
        self.fanned: tuple[Any, ...] | None = None  # those of the fan
        self._fans: dict[int, tuple[str, Parts]] = {}
        first = simulator.result(0)
        self.outputs = [self._view(name) for name in simulator.outputs]
        self.coefficients = [self._view(name) for name in first.coefficients]
        self.inputs = [self._view(name, recorded=True) for name in simulator.inputs]
        left = stacked(self.outputs, "trajectories")
        right = stacked([*self.coefficients, *self.inputs], "coefficients")
        left.tags = [self.exchange]
        self.exchange.on_change("asked", self._asked)
        self.answer(Asked())
        document.title = self.opened.title
        document.add_root(left)
        document.add_root(right)
        document.template = _part("page.html")  # pyright: ignore[reportAttributeAccessIssue] - Bokeh takes a text, too
        document.template_variables.update(self._facts())
        start = CustomJS(
            args={"exchange": self.exchange, "time": self.shared.time}, code="explore.start(exchange, time)"
        )
        document.js_on_event("document_ready", start)

    def _view(self, name: str, *, recorded: bool = False) -> View:
        """`recorded`: nothing is compared with it, so that it has no tolerance."""
        unit, band = self.units.get(name, "1"), None if recorded else self.tolerances.get(name)
        return View(name, axis_label(name, unit), for_people(unit)[1], self.shared, band)

    def _facts(self) -> dict[str, Any]:
        """What the template shows."""
        opened = self.opened
        have = self.simulator.flights.channels
        return {
            "style": _part("page.css"),
            "script": _part("page.js"),
            "heading": opened.title,
            "aircraft": opened.identified.title,
            "version": __version__,
            "manoeuvres": self.simulator.manoeuvres,
            "addable": [(e.name, e.claim) for e in opened.addable(tuple(have))],
            "limits": opened.limits,
            "linear": opened.linear,
            "forms": tuple(FORMS),
            "legend": [(key, COLOURS[key], words) for key, words in WORDS.items()],
            "sources": opened.identified.sources,
            "start": "as fitted" if opened.departures else "as measured",
            "draws": DRAWS,
            "most": MOST,
            "most_fan": MOST_FAN,
        }

    def _asked(self, _attribute: str, _old: str, new: str) -> None:
        """Whatever is asked gets an answer: the browser waits for it before it asks again."""
        number = -1
        try:
            asked = read_asked(new)
            number = asked.id
            self.answer(asked)
        except InputError as reason:
            self.exchange.update(told=json.dumps({"id": number, "error": f"{reason}."}))
        except Exception as reason:  # whatever it is, the page goes on with what it was asked before
            told = failure("What was asked could not be done", reason)
            self.exchange.update(told=json.dumps({"id": number, "error": told}))

    def answer(self, asked: Asked) -> None:
        """Fly, draw and tell what is asked.

        Raises:
            InputError: there is no such manoeuvre, or an added effect cannot be simulated through it.
        """
        begin = clock.perf_counter()
        choice = self._choice(asked)
        before = self.simulator.result(asked.manoeuvre)
        now = before if choice == Choice() else self.simulator.fly(asked.manoeuvre, choice)
        time = self.simulator.time(asked.manoeuvre)
        window = window_of(time, asked.window)
        self._draw(asked, time, window, before, now)
        said, exported, failed = "", "", ""
        try:
            said = self._fanned(asked, time, window)
            if asked.export:
                folder, files = export_chosen(self.opened, choice, now.values, asked.export)
                exported = f"Exported to {folder}: {', '.join(files)}."
        except InputError as reason:
            failed = f"{reason}."
        told = {
            "id": asked.id,
            "window": [float(time[0]), float(time[-1])],
            "groups": self._groups(choice),
            "scores": self._scores(asked.manoeuvre, window, before, now),
            "gain": self._gain(asked.manoeuvre, window, before, now),
            "note": self._note(time, now),
            "said": said,
            "exported": exported,
            "fan": self.fanned is not None,
            "error": failed,
            "seconds": clock.perf_counter() - begin,
        }
        self.exchange.update(told=json.dumps(told))

    def _choice(self, asked: Asked) -> Choice:
        """What is asked, in SI."""
        if asked.manoeuvre >= len(self.simulator.manoeuvres):
            raise InputError(f"there is no manoeuvre {asked.manoeuvre + 1}; choose another one")
        known = {e.name for e in self.opened.addable(tuple(self.simulator.flights.channels))}
        added = tuple(name for name in asked.added if name in known)
        groups = self.opened.groups(added)
        factors = {s.name: s.factor for group in groups for s in group.sliders}
        values = {name: x / factors[name] for name, x in asked.values.items() if name in factors}
        return Choice(values, frozenset(asked.off) & {group.name for group in groups if group.switch}, added)

    def _groups(self, choice: Choice) -> list[dict[str, Any]]:
        """The sliders, for the browser to build."""
        return [asdict(group) for group in self.opened.groups(choice.added)]

    def _draw(self, asked: Asked, time: np.ndarray, window: np.ndarray, before: Flown, now: Flown) -> None:
        """What is flown now always; record and result where manoeuvre or window have changed."""
        at, recorded = time[window], self.simulator.recorded(asked.manoeuvre)
        place = asked.manoeuvre, asked.window
        if place != self.drawn:
            for view in (*self.outputs, *self.inputs):
                view.draw_record(at, recorded[view.name][window])
            for view in self.inputs:
                view.fit([recorded[view.name][window]])
            for view, old, truth in self._pairs(before, recorded):
                view.draw_before(at, old[window])
                view.fit([truth[window], old[window]])
            begin, end = asked.window or (float(time[0]), float(time[-1]))
            self.shared.time.update(start=begin, end=end)
        flown = {**now.simulated, **now.coefficients}
        views = (*self.outputs, *self.coefficients)
        self.shared.draw_now([view.line_now(at, flown[view.name][window]) for view in views])
        for view in self.coefficients:
            formed = now.formed.get(view.name)  # most parameters do not change how coefficients are formed
            if formed is not None and (place != self.drawn or not np.array_equal(formed, self.formed[view.name])):
                view.draw_record(at, formed[window])
        self.drawn, self.formed = place, now.formed

    def _pairs(self, before: Flown, recorded: Parts) -> list[tuple[View, np.ndarray, np.ndarray]]:
        """Panels with the result and what it is compared with."""
        found = [(view, before.simulated[view.name], recorded[view.name]) for view in self.outputs]
        for view in self.coefficients:
            modelled = before.coefficients[view.name]
            found.append((view, modelled, before.formed.get(view.name, modelled)))
        return found

    def _fanned(self, asked: Asked, time: np.ndarray, window: np.ndarray) -> str:
        """Draw the fan, or remove it, where it has changed; where its draws come from."""
        views = [*self.outputs, *self.coefficients]
        place = (asked.manoeuvre, asked.window) if asked.fan else None
        if place != self.fanned and place is None:
            for view in views:
                view.draw_fan(time, np.zeros((0, len(time))))
        elif place is not None and place != self.fanned:
            if asked.manoeuvre not in self._fans:
                self._fans[asked.manoeuvre] = self.simulator.fan(asked.manoeuvre)
            draws = self._fans[asked.manoeuvre][1]
            for view in views:
                view.draw_fan(time[window], draws[view.name][:, window])
        self.fanned = place
        return "" if place is None else f"{DRAWS} draws: {self._fans[asked.manoeuvre][0]}."

    def _scores(self, manoeuvre: int, window: np.ndarray, before: Flown, now: Flown) -> list[dict[str, Any]]:
        """RMS errors and shares inside the tolerances, in the units of the panels."""
        paths = scores(self.simulator.recorded(manoeuvre), before.simulated, now.simulated, window, self.tolerances)
        formed = {name: now.coefficients[name] for name in now.formed}
        changed = {name: now.formed[name] - y for name, y in now.coefficients.items() if name in now.formed}
        first = {name: before.formed[name] - before.coefficients[name] for name in formed}
        still = {name: np.zeros_like(y) for name, y in formed.items()}
        found = []
        for one in (*paths, *scores(still, first, changed, window, {})):
            unit, factor = for_people(self.units.get(one.name, "1"))
            label = f"{axis_label(one.name, self.units.get(one.name, '1'))}"
            row = asdict(one) | {"label": label, "unit": bracket(unit)}
            found.append(row | {"before": factor * one.before, "now": factor * one.now})
        return found

    def _gain(self, manoeuvre: int, window: np.ndarray, before: Flown, now: Flown) -> dict[str, Any]:
        """Change of the log likelihood of the trajectories; residuals as the fit left them, where it was one."""
        told, recorded = self.opened.told, self.simulator.recorded(manoeuvre)
        fitted = told.get("residual_sd", {}) if self.opened.departures else {}
        names = [n for n in (fitted or self.simulator.outputs) if n in before.simulated and n != "altitude"]
        sd = {n: fitted.get(n) or float(np.std(recorded[n] - before.simulated[n])) for n in names}
        sd = {n: x for n, x in sd.items() if x > 0.0}
        inflation = told.get("variance_inflation") or told.get("trajectories", {}).get("variance_inflation") or 1.0
        return {"nats": gain(recorded, before.simulated, now.simulated, window, sd, inflation), "inflation": inflation}

    def _note(self, time: np.ndarray, now: Flown) -> str:
        """Where the simulation has left its envelope, and what is not shown."""
        left = "" if now.inside.all() else f"The simulation leaves the envelope at {time[np.argmin(now.inside)]:.1f} s."
        return " ".join(filter(None, (left, self.simulator.no_coefficients)))


def page_of(simulator: Simulator) -> Callable[[Document], None]:
    """What fills the document of each visitor."""

    def fill(document: Document) -> None:
        Page(simulator, document)

    return fill


def _part(name: str) -> str:
    return (resources.files("bayes_aero.explore") / "templates" / name).read_text(encoding="utf-8")
