"""An effect is added by one entry, a reader, a residual model and a figure by one file each: no list names them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from types import ModuleType

import numpy as np
import pytest

import bayes_aero.effects as effects
import bayes_aero.flight.readers as readers
from bayes_aero.diagnosis import candidate_set
from bayes_aero.diagnosis.candidate_set import candidate_model
from bayes_aero.diagnosis.screening.selection_state import linearised
from bayes_aero.diagnosis.selection.forward_selection import forward_selection
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.model.joined_channels import despiked, join
from bayes_aero.model.observations import observe
from bayes_aero.report import figures
from bayes_aero.report.figures import every_figure
from bayes_aero.residuals.base import Blockwise, ResidualModel
from bayes_aero.residuals.equation_error import EquationError
from bayes_aero.simulate.injection import hidden_flights

ENTRY = '''
"""Drag of the elevator, squared."""
from bayes_aero.effects.lift_drag import ELEVATOR_DRAG
from dataclasses import replace
ELEVATOR_DRAG_AGAIN = replace(ELEVATOR_DRAG, name="elevator_drag_again")
'''
READER = '''
"""Two columns of numbers in octal."""
from bayes_aero.flight.readers.text import open_text
def open_octal(data):
    rows = [line.split() for line in data.decode().splitlines()]
    text = [rows[0], *([str(int(x, 8)) for x in row] for row in rows[1:])]
    return open_text("\\n".join(" ".join(row) for row in text).encode())
READS = {".oct": open_octal}
'''
FIGURE = '''
"""Elevator over time."""
from matplotlib.figure import Figure
def elevator(run):
    figure = Figure()
    figure.subplots().plot(run)
    return figure
FIGURES = {"elevator": elevator}
'''


def beside(package: ModuleType, name: str, text: str, folder, monkeypatch) -> None:
    """The package as if `folder`/`name`.py, which holds `text`, lay in it."""
    (folder / f"{name}.py").write_text(text)
    monkeypatch.setattr(package, "__path__", [*package.__path__, str(folder)])
    monkeypatch.delitem(import_module("sys").modules, f"{package.__name__}.{name}", raising=False)


def test_an_effect_is_one_entry(tmp_path, monkeypatch):
    beside(effects, "more_drag", ENTRY, tmp_path, monkeypatch)
    found = effects._discover()
    assert found.keys() - CATALOGUE.keys() == {"elevator_drag_again"}
    assert list(found) == sorted(found)


def test_two_effects_of_one_name_are_refused(tmp_path, monkeypatch):
    beside(effects, "drag_twice", ENTRY.replace("elevator_drag_again", "elevator_drag"), tmp_path, monkeypatch)
    with pytest.raises(InputError, match="second effect elevator_drag"):
        effects._discover()


def test_a_reader_is_one_file(tmp_path, monkeypatch):
    beside(readers, "octal", READER, tmp_path, monkeypatch)
    found = readers._discover()
    assert found.keys() - readers.READERS.keys() == {".oct"}
    opened = found[".oct"](b"time q\n0 17\n1 20\n")
    assert [heading.names for heading in opened.headings] == [("time",), ("q",)]


def test_a_figure_is_one_file(tmp_path, monkeypatch):
    beside(figures, "elevator", FIGURE, tmp_path, monkeypatch)
    found = {stem: draw for declared in every_figure._declared("FIGURES") for stem, draw in declared.items()}
    assert found.keys() - every_figure.FIGURES.keys() == {"elevator"}
    written, failed = every_figure.draw_all({"elevator": found["elevator"]}, [0.0, 1.0], tmp_path / "figures")
    assert [path.name for path in written] == ["elevator.png"]
    assert not failed


@dataclass(frozen=True)
class LiftError(Blockwise):
    """A residual model of this file alone: the lift coefficient, measured minus modelled."""

    whole: EquationError

    @property
    def flights(self):
        return self.whole.flights

    @property
    def model(self):
        return self.whole.model

    @property
    def outputs(self) -> tuple[str, ...]:
        return ("CL",)

    def evaluate(self, theta) -> tuple[np.ndarray, Mapping[str, np.ndarray]]:
        residual, explained = self.whole.evaluate(theta)
        return residual[:, :1], explained

    def with_channels(self, channels):
        return LiftError(self.whole.with_channels(channels))

    def offsets(self, theta, outputs: Sequence[str]) -> np.ndarray:  # noqa: ARG002
        return np.zeros((len(self.manoeuvre), 1, 0))

    def slopes(self, theta, directions):
        residual, slopes = self.whole.slopes(theta, directions)
        return residual[:, :1], slopes[:, :, :1]


@pytest.fixture(scope="module")
def hidden():
    return [f.record for f in hidden_flights({"pitch_rate_lift": {"CLq": 8.0}}, seed=43, noise="white", seconds=60.0)]


def test_a_residual_model_is_one_file(hidden, card, model, monkeypatch):
    """Linearisation, screening, forward selection, hold-out and sizes run over a class that they do not know."""
    flights, _ = despiked(join(hidden, card))
    monkeypatch.setattr(candidate_set, "CATALOGUE", {name: e for name, e in CATALOGUE.items() if "_lift" in name})
    full = candidate_model(model, flights)
    fit = fit_mle(model, observe(hidden, card, model), seed=0, extra_starts=0)
    values = full.neutral | {n: x for n, x in zip(fit.names, fit.estimate, strict=True) if n in full.neutral}
    lift: ResidualModel = LiftError(EquationError.of(flights, full.model))
    state = linearised(full, lift, lift.outputs, np.array([values[n] for n in full.model.names]))
    found = forward_selection(state, seed=0)
    assert found.causes[:1] == ("pitch_rate_lift",)
    size = found.sizes["CLq"]
    assert abs(size.mean - 8.0) < 4.0 * size.sd
