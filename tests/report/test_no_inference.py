"""Nothing in the report infers: it takes results from below, and no function that fits, samples or simulates."""

from __future__ import annotations

import ast
from importlib import import_module, resources
from inspect import isfunction, ismodule
from pathlib import Path

import pytest

import bayes_aero

BELOW = ("diagnosis", "inference", "residuals", "dynamics", "model")
DESCRIBE = {"score", "interval_coverage", "with_sums"}  # of two arrays; sums of channels
PROBLEMS = {"state", "responses", "aerodynamics"}  # regression problems, from which anything can be fitted
COMPUTING = {
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
    assert not {function.attr for function in called if isinstance(function, ast.Attribute)} & COMPUTING


def test_the_check_sees_what_it_forbids():
    tree = ast.parse("from bayes_aero.inference.stall import stall_of\nfrom bayes_aero.report.style import save")
    assert taken(tree) == [("bayes_aero.inference.stall", "stall_of")]
    assert isfunction(import_module("bayes_aero.inference.stall").stall_of)
