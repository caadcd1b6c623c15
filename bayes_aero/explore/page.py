"""The page of one visitor: what is asked in the browser is flown, drawn and answered; and its server."""

from __future__ import annotations

import errno
import json
import logging
import socket
import time as clock
import webbrowser
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from importlib import resources
from typing import Annotated, Any

import msgspec
import numpy as np
from bokeh import models
from bokeh.core.properties import String
from bokeh.document import Document
from bokeh.layouts import column
from bokeh.model import DataModel
from bokeh.plotting import figure
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from bokeh.settings import settings
from jaxtyping import Bool, Float
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPMessageDelegate, HTTPServerRequest
from tornado.ioloop import IOLoop
from tornado.routing import Router
from tornado.web import ErrorHandler

from bayes_aero import __version__
from bayes_aero.errors import InputError, failure
from bayes_aero.explore.opened import DRAWS, Choice, Flown, Simulator, export_chosen
from bayes_aero.flight.card import channel_units
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.jobs.finished import FORMS
from bayes_aero.jobs.options import ExportForm
from bayes_aero.report.phrases import axis_label, bracket, for_people
from bayes_aero.report.plots import COLOURS, FARTHEST, Line, extremes, scale

Parts = Mapping[str, np.ndarray]
Curve = Float[np.ndarray, " n"]
Series = Mapping[str, Curve]
MOST_CHARACTERS = 100_000


class Exchange(DataModel):
    asked = String("")
    told = String("")


class ExplorePage:
    def __init__(self, simulator: Simulator, document: Document) -> None:
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
        self.answer(Asked(0))
        facts = {
            "style": _part("page.css"),
            "script": _part("page.js"),
            "heading": self.opened.title,
            "aircraft": self.opened.identified.title,
            "version": __version__,
            "manoeuvres": simulator.manoeuvres,
            "addable": [(e.name, e.claim) for e in self.opened.addable(tuple(simulator.flights.channels))],
            "limits": self.opened.limits,
            "linear": self.opened.linear is not None,
            "forms": tuple(FORMS),
            "legend": [(key, COLOURS[key], words) for key, words in WORDS.items()],
            "sources": self.opened.identified.sources,
            "start": "as fitted" if self.opened.departures else "as measured",
            "draws": DRAWS,
            "most": MOST,
            "most_fan": MOST_FAN,
        }
        document.title = self.opened.title
        document.add_root(left)
        document.add_root(right)
        document.template = _part("page.html")  # pyright: ignore[reportAttributeAccessIssue] - Bokeh takes a text, too
        document.template_variables.update(facts)
        given = {"exchange": self.exchange, "time": self.shared.time}
        document.js_on_event("document_ready", models.CustomJS(args=given, code="explore.start(exchange, time)"))

    def _view(self, name: str, *, recorded: bool = False) -> TimePanel:
        """`recorded`: nothing is compared with it, so that it has no tolerance."""
        unit, band = self.units.get(name, "1"), None if recorded else self.tolerances.get(name)
        return TimePanel(name, axis_label(name, unit), for_people(unit)[1], self.shared, band)

    def _asked(self, _attribute: str, _old: str, new: str) -> None:
        """Whatever is asked gets an answer: the browser waits for it before it asks again."""
        number = -1
        try:
            request = read_asked(new)
            number = request.id
            self.answer(request)
        except InputError as reason:
            self.exchange.update(told=json.dumps({"id": number, "error": f"{reason}."}))
        except Exception as reason:  # whatever it is, the page goes on with what it was asked before
            sentence = failure("What was asked could not be done", reason)
            self.exchange.update(told=json.dumps({"id": number, "error": sentence}))

    def answer(self, request: Asked) -> None:
        began = clock.perf_counter()
        choice = self._choice(request)
        before = self.simulator.result(request.manoeuvre)
        now = before if choice == Choice() else self.simulator.fly(request.manoeuvre, choice)
        time = self.simulator.time(request.manoeuvre)
        begin, end = request.window or (-np.inf, np.inf)
        window = (time >= begin) & (time <= end)
        window = window if window.sum() > 1 else np.ones(len(time), bool)
        self._draw(request, time, window, before, now)
        origin, exported, failed = "", "", ""
        try:
            origin = self._fanned(request, time, window)
            if request.export:
                folder, files = export_chosen(self.opened, choice, now.values, request.export)
                exported = f"Exported to {folder}: {', '.join(files)}."
        except InputError as reason:
            failed = f"{reason}."
        left = "" if now.inside.all() else f"The simulation leaves the envelope at {time[np.argmin(now.inside)]:.1f} s."
        reply = {
            "id": request.id,
            "window": [float(time[0]), float(time[-1])],
            "groups": [asdict(group) for group in self.opened.groups(choice.added)],
            "scores": self._scores(request.manoeuvre, window, before, now),
            "gain": self._gain(request.manoeuvre, window, before, now),
            "note": " ".join(filter(None, (left, self.simulator.no_coefficients))),
            "said": origin,
            "exported": exported,
            "fan": self.fanned is not None,
            "error": failed,
            "seconds": clock.perf_counter() - began,
        }
        self.exchange.update(told=json.dumps(reply))

    def _choice(self, request: Asked) -> Choice:
        if request.manoeuvre >= len(self.simulator.manoeuvres):
            raise InputError(f"there is no manoeuvre {request.manoeuvre + 1}; choose another one")
        addable = {e.name for e in self.opened.addable(tuple(self.simulator.flights.channels))}
        added = tuple(name for name in dict.fromkeys(request.added) if name in addable)
        groups = self.opened.groups(added)
        factors = {s.name: s.factor for group in groups for s in group.sliders}
        values = {name: x / factors[name] for name, x in request.values.items() if name in factors}
        return Choice(values, frozenset(request.off) & {group.name for group in groups if group.switch}, added)

    def _draw(self, request: Asked, time: np.ndarray, window: np.ndarray, before: Flown, now: Flown) -> None:
        """What is flown now always; record and result where manoeuvre or window have changed."""
        at, recorded = time[window], self.simulator.recorded(request.manoeuvre)
        place = request.manoeuvre, request.window
        if place != self.drawn:
            for view in (*self.outputs, *self.inputs):
                view.draw_record(at, recorded[view.name][window])
            for view in self.inputs:
                view.fit([recorded[view.name][window]])
            for view in (*self.outputs, *self.coefficients):
                old = {**before.simulated, **before.coefficients}[view.name]
                truth = recorded[view.name] if view in self.outputs else before.formed.get(view.name, old)
                view.before.update(data=view.line(at, old[window]))
                view.fit([truth[window], old[window]])
            begin, end = request.window or (float(time[0]), float(time[-1]))
            self.shared.time.update(start=begin, end=end)
        flown = {**now.simulated, **now.coefficients}
        views = (*self.outputs, *self.coefficients)
        self.shared.draw_now([view.line(at, flown[view.name][window], view.columns) for view in views])
        for view in self.coefficients:
            formed = now.formed.get(view.name)  # most parameters do not change how coefficients are formed
            if formed is not None and (place != self.drawn or not np.array_equal(formed, self.formed[view.name])):
                view.draw_record(at, formed[window])
        self.drawn, self.formed = place, now.formed

    def _fanned(self, request: Asked, time: np.ndarray, window: np.ndarray) -> str:
        """Draw the fan, or remove it, where it has changed; where its draws come from."""
        views = [*self.outputs, *self.coefficients]
        place = (request.manoeuvre, request.window) if request.fan else None
        if place is not None and request.manoeuvre not in self._fans:
            self._fans[request.manoeuvre] = self.simulator.fan(request.manoeuvre)
        for view in views if place != self.fanned else ():
            draws = np.zeros((0, len(time))) if place is None else self._fans[request.manoeuvre][1][view.name]
            view.draw_fan(time[window], draws[:, window])
        self.fanned = place
        return "" if place is None else f"{DRAWS} draws: {self._fans[request.manoeuvre][0]}."

    def _scores(self, manoeuvre: int, window: np.ndarray, before: Flown, now: Flown) -> list[dict[str, Any]]:
        paths = scores(self.simulator.recorded(manoeuvre), before.simulated, now.simulated, window, self.tolerances)
        errors = [{name: x - flown.coefficients[name] for name, x in flown.formed.items()} for flown in (before, now)]
        still = {name: np.zeros_like(y) for name, y in errors[1].items()}
        rows = [*paths, *scores(still, errors[0], errors[1], window, {})]
        for row in rows:
            si = self.units.get(row["name"], "1")
            unit, factor = for_people(si)
            row |= {"label": axis_label(row["name"], si), "unit": bracket(unit)}
            row |= {key: factor * row[key] for key in ("before", "now")}
        return rows

    def _gain(self, manoeuvre: int, window: np.ndarray, before: Flown, now: Flown) -> dict[str, Any]:
        """Change of the log likelihood of the trajectories; residuals as the fit left them, where it was one."""
        stored, recorded = self.opened.told, self.simulator.recorded(manoeuvre)
        fitted = stored.get("residual_sd", {}) if self.opened.departures else {}
        errors = []
        for n in (n for n in (fitted or self.simulator.outputs) if n in before.simulated and n != "altitude"):
            old, new = (recorded[n] - flown.simulated[n] for flown in (before, now))
            if (sd := fitted.get(n) or float(np.std(old))) > 0.0:
                errors.append((old[window] / sd, new[window] / sd))
        inflation = stored.get("variance_inflation") or stored.get("trajectories", {}).get("variance_inflation") or 1.0
        return {"nats": gain(errors, inflation), "inflation": inflation}


def _part(name: str) -> str:
    return (resources.files("bayes_aero.explore") / "templates" / name).read_text(encoding="utf-8")


class Asked(msgspec.Struct, frozen=True):
    """The state of the page's controls; values are in the units of the sliders, `window` in s."""

    id: int
    manoeuvre: Annotated[int, msgspec.Meta(ge=0)] = 0
    window: tuple[float, float] | None = None
    values: dict[str, float] = {}
    off: tuple[str, ...] = ()
    added: tuple[str, ...] = ()
    fan: bool = False
    export: ExportForm | None = None


def read_asked(text: str) -> Asked:
    try:
        return msgspec.json.decode(text if len(text) <= MOST_CHARACTERS else "", type=Asked)
    except (ValueError, RecursionError) as reason:
        raise InputError(f"the page sent what it never sends ({reason}); load it again") from None


def scores(
    recorded: Series, before: Series, now: Series, window: Bool[np.ndarray, " n"], tolerances: Mapping[str, float]
) -> Iterator[dict[str, Any]]:
    """RMS errors of the result and now over the samples of `window`, SI, and shares inside the tolerance, if any."""
    for name, y in now.items():
        old, new = (np.abs(recorded[name] - x)[window] for x in (before[name], y))
        band = tolerances.get(name)
        rms = {"before": _rms(old), "now": _rms(new)}
        shares = (None, None) if band is None else (float(np.mean(old <= band)), float(np.mean(new <= band)))
        yield {"name": name, **rms, "within_before": shares[0], "within": shares[1]}


def gain(errors: Iterable[tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]], inflation: float) -> float:
    """Change of the log likelihood from the result to now, nats, by the normal errors of both over their deviation;
    `inflation`: samples that count for one, because residuals are coloured.

    Source:
        Jategaonkar, Flight Vehicle System Identification, 2nd ed. 2015, eq. 4.11, with a diagonal covariance.
    """
    return 0.5 * sum(float(np.sum(old**2) - np.sum(new**2)) for old, new in errors) / inflation


def _rms(x: Float[np.ndarray, " n"]) -> float:
    return float(np.sqrt(np.mean(x**2))) if len(x) else float("nan")


# --- Panels over one time axis: the record with its tolerance, the result, what is flown now, and draws as a fan.

MOST = 900  # points a line in the window: more than a panel has columns
MOST_FAN = 200  # and of each draw
LEAST, AXIS = 84, 42  # pixels: lowest panel, and the time axis below the last
WORDS = {"measured": "measured", "before": "result", "after": "now", "crb": "draws"}  # what the colours mean


class Shared:
    """What all panels have in common: the range of time, the cross-hair, and the source of what is flown now."""

    def __init__(self) -> None:
        self.time = models.Range1d(start=0.0, end=1.0)
        self.cross = models.Span(dimension="height", line_dash="dotted", line_color="#777777", line_width=1)
        self.now = models.ColumnDataSource({}, name="now")

    def draw_now(self, lines: Sequence[Mapping[str, np.ndarray]]) -> None:
        """The columns of all panels, made equally long by gaps."""
        every = {name: np.zeros(0) for name in self.now.column_names}
        for line in lines:
            every |= line
        n = max(map(len, every.values()))
        self.now.update(data={k: np.pad(x, (0, n - len(x)), constant_values=np.nan) for k, x in every.items()})


class TimePanel:
    """One panel. `factor` converts SI to the unit of its label, `band` (SI) is the tolerance about the measurement.
    What is flown now has one source for all panels, so that a step is one message to the browser."""

    def __init__(self, name: str, label: str, factor: float, shared: Shared, band: float | None) -> None:
        self.name, self.label, self.factor = name, label, factor
        self.band = None if band is None else factor * band
        self.record = models.ColumnDataSource({"t": [], "y": [], "low": [], "high": []})
        self.before = models.ColumnDataSource({"t": [], "y": []})
        self.columns = f"t {name}", f"y {name}"
        self.fan = models.ColumnDataSource({"xs": [], "ys": []}, name=f"fan-{name}")
        self.range = models.Range1d(start=0.0, end=1.0)
        box = models.BoxZoomTool(dimensions="width")
        wheel = models.WheelZoomTool(dimensions="width", modifiers={"ctrl": True})
        f = self.figure = figure(
            x_range=shared.time,
            y_range=self.range,
            y_axis_label=label,
            sizing_mode="stretch_both",
            min_height=LEAST,
            tools=[box, wheel, models.CrosshairTool(overlay=shared.cross)],
            active_drag=box,
            toolbar_location=None,
            min_border=3,
            min_border_left=62,
            min_border_right=6,
        )
        if self.band is not None:
            f.varea("t", "low", "high", source=self.record, fill_color="#999999", fill_alpha=0.28)
        f.multi_line("xs", "ys", source=self.fan, line_color=COLOURS["crb"], line_alpha=0.3, line_width=1)
        shown = f.line("t", "y", source=self.record, color=COLOURS["measured"], line_width=1.3)
        t, y = self.columns
        shared.now.add([], t)
        shared.now.add([], y)
        now = f.line(t, y, source=shared.now, color=COLOURS["after"], line_width=2.0, level="overlay")
        before = {"color": COLOURS["before"], "line_dash": "dashed", "line_width": 1.4, "level": "overlay"}
        f.line("t", "y", source=self.before, **before)
        for line, (at, value) in ((now, self.columns), (shown, ("t", "y"))):
            tips = [("t", f"@{{{at}}}{{0.00}} s"), (label, f"@{{{value}}}{{0.[0000]}}")]
            f.add_tools(models.HoverTool(renderers=[line], mode="vline", tooltips=tips, line_policy="nearest"))

    def draw_record(self, time: Curve, y: Curve) -> None:
        t, y = self._drawable(time, y)
        half = self.band or 0.0
        self.record.update(data={"t": t, "y": y, "low": y - half, "high": y + half})

    def line(self, time: Curve, y: Curve, columns: tuple[str, str] = ("t", "y")) -> dict[str, np.ndarray]:
        return dict(zip(columns, self._drawable(time, y), strict=True))

    def draw_fan(self, time: Curve, draws: Float[np.ndarray, "m n"]) -> None:
        lines = [self._drawable(time, y, MOST_FAN) for y in draws]
        self.fan.update(data={"xs": [t for t, _ in lines], "ys": [y for _, y in lines]})

    def _drawable(self, time: Curve, y: Curve, most: int = MOST) -> tuple[np.ndarray, np.ndarray]:
        """A line in the panel's unit that a canvas can take; values of a diverged simulation are gaps."""
        y = self.factor * y
        index = extremes([y], most)
        return time[index], np.where(np.abs(y[index]) < FARTHEST, y[index], np.nan)

    def fit(self, shown: Sequence[Curve]) -> None:
        """A vertical scale for the measurement (first) and the result; what is flown now cannot flatten them."""
        lines = tuple(Line("", "", self.factor * y) for y in shown)
        start, end = scale(lines, self.band)
        self.range.update(start=start, end=end)


def stacked(views: Sequence[TimePanel], name: str) -> models.Column:
    for view in views:
        last = view is views[-1]
        f: Any = view.figure
        f.xaxis.visible, f.grid.grid_line_color, f.outline_line_color = last, "#dddddd", "#bbbbbb"
        for axis in (f.xaxis, f.yaxis):
            axis.update(axis_label_text_font_size="13px", major_label_text_font_size="12px", minor_tick_line_color=None)
            axis.update(axis_label_text_color="#222222", major_label_text_color="#222222")
            axis.axis_label_text_font_style = "normal"
        f.yaxis.ticker.desired_num_ticks = 3
        if last:
            f.xaxis.axis_label = "time of the record [s]"
            f.min_height = LEAST + AXIS
    return column([view.figure for view in views], sizing_mode="stretch_both", spacing=0, name=name)


# --- The server of the page: this machine alone, nothing from a network.

ADDRESS = "127.0.0.1"


class LocalOnly(Router):
    """Requests whose Host header names this machine go to the page, all others are refused. A foreign name that
    resolves to 127.0.0.1 could otherwise read the page through the user's browser."""

    def __init__(self, app: BokehTornado, hosts: frozenset[str]) -> None:
        self.app, self.hosts = app, hosts  # these with the port

    def find_handler(self, request: HTTPServerRequest, **kwargs: object) -> HTTPMessageDelegate | None:  # noqa: ARG002
        if request.host.lower() in self.hosts:
            return self.app.find_handler(request)
        return self.app.get_handler_delegate(request, ErrorHandler, {"status_code": 403})


class PageServer:
    """A running server; `url` is its address."""

    def __init__(self, fill: Callable[[Document], Any], port: int = 0) -> None:
        """Listen at once on a port of this machine, 0: any free one; `fill` makes the page of one visitor."""
        for name in ("bokeh", "tornado"):
            logging.getLogger(name).setLevel(logging.ERROR)
        settings.resources = "server"  # whatever the environment says: no content delivery network,
        settings.allowed_ws_origin = []  # and no other origin
        try:
            listening = socket.create_server((ADDRESS, port))
        except OSError as reason:
            taken = "it is taken" if reason.errno == errno.EADDRINUSE else reason.strerror or reason
            raise InputError(f"port {port} cannot be used ({taken}); give another --port, or none") from None
        listening.setblocking(False)
        self.port = int(listening.getsockname()[1])
        hosts = frozenset(f"{name}:{self.port}" for name in (ADDRESS, "localhost"))
        self.url = f"http://{ADDRESS}:{self.port}/"
        app = BokehTornado({"/": fill}, extra_websocket_origins=sorted(hosts), absolute_url=self.url)
        http = HTTPServer(LocalOnly(app, hosts))
        http.add_socket(listening)
        self.loop = IOLoop.current()
        self._server = BaseServer(self.loop, app, http)

    def serve(self, *, browser: bool = False) -> None:
        self._server.start()
        if browser:
            self.loop.add_callback(webbrowser.open, self.url)
        try:
            self.loop.start()
        except KeyboardInterrupt:
            pass
        finally:
            self.stop()

    def stop(self) -> None:
        self._server.stop(wait=False)
