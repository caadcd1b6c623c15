"""The size of the project: a count that rises fails, and a commit that lowers one lowers its limit here."""

from __future__ import annotations

import ast
from collections import Counter, defaultdict
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LIMITS = {
    "bayes_aero: lines": 42000,
    "bayes_aero: files": 130,
    "bayes_aero: private helpers used once": 231,
    "bayes_aero: class names with several meanings": 0,
    "tests: lines": 21912,
    "tests: files": 85,
    "benchmarks: lines": 4500,
    "benchmarks: files": 25,
    "benchmarks/README.md: lines": 250,
    "CHANGELOG.md: lines": 150,
    "docs: words": 24966,
}
LEFT = 0.02  # share of a limit by which a count may lie below it


def sources(folder: str) -> dict[Path, str]:
    return {p: p.read_text("utf-8") for p in (ROOT / folder).rglob("*.py") if "__pycache__" not in p.parts}


def used_once(tree: ast.Module) -> int:
    """Functions with a leading underscore whose name is used once in their module."""
    names = [n.id for n in ast.walk(tree) if isinstance(n, ast.Name)]
    uses = Counter([*names, *(n.attr for n in ast.walk(tree) if isinstance(n, ast.Attribute))])
    own = [n.name for n in ast.walk(tree) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)]
    return sum(uses[name] == 1 for name in own if name.startswith("_") and not name.startswith("__"))


def counts() -> dict[str, int]:
    """Every count that has a limit."""
    found = {}
    for folder in ("bayes_aero", "tests", "benchmarks"):
        files = sources(folder)
        found[f"{folder}: lines"] = sum(len(text.splitlines()) for text in files.values())
        found[f"{folder}: files"] = len(files)
    trees = {path: ast.parse(text) for path, text in sources("bayes_aero").items()}
    classes = defaultdict(set)
    for path, tree in trees.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                classes[node.name].add(path)
    found["bayes_aero: private helpers used once"] = sum(used_once(tree) for tree in trees.values())
    found["bayes_aero: class names with several meanings"] = sum(len(paths) > 1 for paths in classes.values())
    for name in ("benchmarks/README.md", "CHANGELOG.md"):
        found[f"{name}: lines"] = len((ROOT / name).read_text("utf-8").splitlines())
    found["docs: words"] = sum(len(p.read_text("utf-8").split()) for p in (ROOT / "docs").rglob("*.md"))
    return found


@pytest.fixture(scope="module")
def counted() -> dict[str, int]:
    return counts()


@pytest.mark.parametrize("what", LIMITS)
def test_the_project_does_not_grow(counted, what):
    assert counted[what] <= LIMITS[what]


@pytest.mark.parametrize("what", LIMITS)
def test_limits_follow_the_counts_down(counted, what):
    assert counted[what] >= (1.0 - LEFT) * LIMITS[what], "set the limit to the count"
