"""The package: one entry or file for what is added, no inference in reports, compiled once, checked as it runs."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from dataclasses import dataclass
from importlib import import_module, resources
from inspect import isfunction, ismodule
from pathlib import Path
from types import ModuleType

import jax
import numpy as np
import pytest
from beartype.roar import BeartypeCallHintViolation
from jaxtyping import Float
from typechecker import check_once

import bayes_aero
import bayes_aero.effects as effects
import bayes_aero.flight.readers as readers
from bayes_aero.diagnosis.candidate_set import DiagnosisSettings
from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.record import FlightRecord
from bayes_aero.physics.filters import smooth
from bayes_aero.report import figures
from bayes_aero.report.figures import every_figure

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


def test_an_effect_is_one_entry_and_a_second_of_its_name_is_refused(tmp_path, monkeypatch):
    beside(effects, "more_drag", ENTRY, tmp_path, monkeypatch)
    found = effects._discover()
    assert found.keys() - CATALOGUE.keys() == {"elevator_drag_again"}
    assert list(found) == sorted(found)
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


BELOW = ("diagnosis", "inference", "residuals", "dynamics", "model")
DESCRIBE = {"score", "interval_coverage", "with_sums"}  # of two arrays; sums of channels
PROBLEMS = {"state", "responses", "aerodynamics"}  # regression problems, from which anything can be fitted
COMPUTE = {
    *("evaluate", "linearise", "refitted", "first_order", "coefficients", "flow", "predict", "draws"),
    *("standard_normal", "default_rng", "lstsq", "solve"),
}
PACKAGE = Path(str(resources.files(bayes_aero)))
MODULES = sorted(PACKAGE.joinpath("report").rglob("*.py"))


def taken(tree: ast.Module) -> list[tuple[str, str]]:
    """Modules of the layers below and the names that are imported from them."""
    found = [(n.module, a.name) for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) and n.module for a in n.names]
    return [(module, name) for module, name in found if module.split(".")[:2] in [["bayes_aero", x] for x in BELOW]]


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_a_report_takes_results_and_computes_none(path):
    tree = ast.parse(path.read_text())
    for module, name in taken(tree):
        thing = getattr(import_module(module), name)
        assert not ismodule(thing), f"{module}.{name}: import its results by name"
        computes = isfunction(thing) or hasattr(thing, "__wrapped__")
        assert name in DESCRIBE or not computes, f"{module}.{name} computes"
    assert not {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)} & PROBLEMS
    called = {node.func for node in ast.walk(tree) if isinstance(node, ast.Call)}
    assert not {function.attr for function in called if isinstance(function, ast.Attribute)} & COMPUTE


def test_the_check_sees_what_it_forbids():
    tree = ast.parse("from bayes_aero.inference.calibration import stall_of\nfrom bayes_aero.report.style import save")
    assert taken(tree) == [("bayes_aero.inference.calibration", "stall_of")]
    assert isfunction(import_module("bayes_aero.inference.calibration").stall_of)


def renamed(record, name):
    channels = {key: record.channels[key] for key in record.channels}
    return FlightRecord.from_arrays(name, record.time, channels, record.source)


@pytest.fixture
def traced():
    """Names of the functions that are traced from here on."""
    seen = []

    def listen(event, _, **told):
        if event == "/jax/core/compile/jaxpr_trace_duration":
            seen.append(told.get("fun_name", "?"))

    jax.monitoring.register_event_duration_secs_listener(listen)
    return seen


def test_records_of_other_names_run_the_compiled_programs(traced, diagnosed, card):
    """After one diagnosis, the same flight under another name compiles nothing.

    The fixture's diagnosis does not count: tests between it and this one may have made the process forget its programs.
    """
    (record,) = diagnosed.records
    settings = DiagnosisSettings(max_effects=2)
    diagnose([record], card, settings=settings)
    traced.clear()
    again = diagnose([renamed(record, "the same flight")], card, settings=settings)
    assert [c.name for c in again.causes] == [c.name for c in diagnosed.view.diagnosis.causes]
    assert not set(traced) & {"_linearise", "_residuals"}, traced
    jax.jit(lambda x: x + 1.0)(1.0)
    assert "<lambda>" in traced, "tracing was not listened to"


OWN = "--xla_cpu_use_fusion_emitters=true"


@pytest.mark.parametrize(
    ("flags", "found"),
    [
        ("", "--xla_cpu_use_fusion_emitters=false"),
        (
            "--xla_cpu_multi_thread_eigen=false",
            "--xla_cpu_multi_thread_eigen=false --xla_cpu_use_fusion_emitters=false",
        ),
        (OWN, OWN),
    ],
)
def test_the_former_emitters_are_asked_for_unless_flags_say_otherwise(flags, found):
    """And the compiler knows the flag: an unknown one would end the process at the first program."""
    code = "import os, bayes_aero, jax; print(os.environ['XLA_FLAGS']); print(float(jax.numpy.ones(2).sum()))"
    environment = os.environ | {"XLA_FLAGS": flags}
    told = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert told.stdout.splitlines() == [found, "2.0"]


N, M = np.zeros(3), np.zeros(4)


@check_once
def both(x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"], scale: float = 1.0) -> Float[np.ndarray, " n"]:
    return np.concatenate([x, y]) if scale < 0.0 else scale * (x + y)


@check_once
@dataclass
class Pair:
    x: Float[np.ndarray, " n"]
    y: Float[np.ndarray, " n"]


def test_what_fits_passes_and_the_package_is_checked():
    assert both(N, N, 2).shape == (3,)
    assert both(M, M).shape == (4,)  # a letter means another size at the next call
    assert Pair(N, y=N).x is N
    with pytest.raises(BeartypeCallHintViolation):
        smooth("no signal", 0.1)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: both(N, M),
        lambda: both(N, N, "1"),
        lambda: both(N, np.zeros((3, 1))),
        lambda: both(N, np.zeros(3, dtype=int)),
        lambda: both(N, N, -1.0),  # the result is twice as long
        lambda: Pair(N, M),
    ],
)
def test_what_does_not_fit_is_refused(wrong):
    with pytest.raises(BeartypeCallHintViolation):
        wrong()


def test_xdist_knows_the_groups(request):
    """It does so by the names of the tests; spread over the workers they take several times as long."""
    if not request.config.getoption("loadgroup", False):
        pytest.skip("runs in the workers of --dist loadgroup only")
    assert request.node.nodeid.endswith("@test_package")
