"""The documentation: it builds strictly, what is generated is complete, nothing is fetched, its examples run."""

import ast
import os
import re
import subprocess
import sys
from html import unescape
from pathlib import Path

import pytest
from browsing import needed

import bayes_aero as ba
from bayes_aero.flight.aircraft import AIRCRAFT_KEYS
from bayes_aero.flight.card.card import PARAMETER_KEYS, SECTIONS
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.jobs.io.documents import document_schema
from bayes_aero.parameter import FAMILIES

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
BLOCK = re.compile(r"<!-- (run|file ([\w.]+)) -->\n```python\n(.*?)```", re.DOTALL)
FETCHED = re.compile(
    r"<(?:script|img|iframe)[^>]+src=\"(?:https?:)?//|<link[^>]+rel=\"stylesheet\"[^>]+href=\"(?:https?:)?//"
)
LONG = ("tutorial",)  # it fits two models
PAGES = [
    pytest.param(path, id=path.stem, marks=[pytest.mark.recovery] if path.stem in LONG else [])
    for path in sorted(DOCS.rglob("*.md"))
    if BLOCK.search(path.read_text(encoding="utf-8"))
]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, built strictly: a dead link or a missing name fails the build."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    settings = os.environ | {"NO_MKDOCS_2_WARNING": "1", "JAX_PLATFORMS": "cpu"}
    ended = subprocess.run(command, cwd=ROOT, env=settings, capture_output=True, text=True, timeout=300, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return folder


def text_of(page: Path) -> str:
    return unescape(page.read_text(encoding="utf-8"))


def test_nothing_is_fetched_from_elsewhere(site):
    pages = list(site.rglob("*.html"))
    assert len(pages) > 20
    for page in pages:
        assert not FETCHED.search(page.read_text(encoding="utf-8")), page.name


@needed
def test_pages_opened_from_a_folder_can_be_searched(site, browser):
    page = browser.new_page()
    asked = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto((site / "index.html").as_uri())
    page.fill("input[name=query]", "separation_hysteresis")
    found = page.wait_for_selector(".md-search-result__item a", timeout=30_000)
    assert "reference/effects.html" in found.get_attribute("href")
    assert all(url.startswith("file:") for url in asked)


def test_reference_lists_every_public_name_effect_and_option(site):
    reference = text_of(site / "reference" / "api.html")
    for name in set(ba.__all__) - {"__version__"}:
        assert name in reference, name
    catalogue = text_of(site / "reference" / "effects.html")
    for effect in ba.CATALOGUE.values():
        assert f'id="{effect.name}"' in catalogue
        assert effect.claim in catalogue
        assert all(p.name in catalogue for p in effect.parameters)
    commands = text_of(site / "reference" / "cli.html")
    assert all(word in commands for word in ("bayes-aero identify", "bayes-aero diagnose", "--max-effects", "--noise"))


def test_reference_explains_every_key_of_a_card(site):
    card = text_of(site / "reference" / "card.html")
    keys = {*AIRCRAFT_KEYS, *STANDARD_CHANNELS, *PARAMETER_KEYS, *FAMILIES}
    keys |= {"column", "label", "unit", "required", "effects", "effect_files", "fixed", "states", "rates", "outputs"}
    for key in keys:
        assert f"<code>{key}</code>" in card or f"<code>{key}." in card, key
    for section in set(SECTIONS) - {"title", "source"}:
        assert f"<code>[{section}]</code>" in card or f"<code>[{section}.NAME]</code>" in card, section


@pytest.mark.parametrize("name", ["results", "diagnosis", "trajectories", "qualification"])
def test_reference_lists_every_key_of_the_schemas(site, name):
    page = text_of(site / "reference" / "schemas.html")
    schema = document_schema(name)
    found = {key for part in (schema, *schema["$defs"].values()) for key in part["properties"]}
    assert len(found) > 10
    assert {key for key in found if not re.search(rf"<code>[^<]*\b{re.escape(key)}</code>", page)} == set()


@pytest.mark.parametrize("page", PAGES)
def test_examples_marked_to_be_run_do(page, tmp_path, monkeypatch):
    """Blocks after `<!-- run -->` run in their order; those after `<!-- file NAME -->` are written first."""
    blocks = BLOCK.findall(page.read_text(encoding="utf-8"))
    for _, name, code in blocks:
        if name:
            (tmp_path / name).write_text(code, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    namespace: dict[str, object] = {}
    for kind, _, code in blocks:
        if kind == "run":
            exec(compile(code, str(page), "exec"), namespace)


def test_the_effect_of_the_how_to_works_out_its_own_example(tmp_path):
    """And a card finds it by its file."""
    page = (DOCS / "howto" / "new_effect.md").read_text(encoding="utf-8")
    _, name, code = BLOCK.findall(page)[0]
    (tmp_path / name).write_text(code, encoding="utf-8")
    from bayes_aero.model.model import own_effects

    effect = own_effects([tmp_path / name])["power_moment"]
    example, aircraft = effect.example, type("Wing", (), {"wing_area": 60.0})()
    found = effect.increments(example.parameters, example.signals, aircraft, {})
    assert found == pytest.approx(dict(example.increments))


def test_no_part_of_a_sentence_stands_outside_its_parentheses():
    """A string that is a statement by itself is a docstring, or the lost end of another string."""
    for path in sorted(Path(ba.__file__).parent.rglob("*.py")):
        source = path.read_text(encoding="utf-8")
        alone = [n.value for n in ast.walk(ast.parse(source)) if isinstance(n, ast.Expr)]
        texts = [x for x in alone if isinstance(x, ast.JoinedStr) or isinstance(getattr(x, "value", None), str)]
        lost = [x.lineno for x in texts if not (ast.get_source_segment(source, x) or "").startswith(('"""', 'r"""'))]
        assert not lost, f"{path}: {lost}"
