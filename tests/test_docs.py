"""Documentation and notebooks: they build strictly, are complete, fetch nothing, and their examples run."""

import os
import re
import subprocess
import sys
from html import unescape
from pathlib import Path

import nbformat
import pytest
from browsing import needed

import bayes_aero as ba
from bayes_aero.flight.card import PARAMETER_KEYS, SECTIONS
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.jobs.documents import document_schema
from bayes_aero.parameter import FAMILIES
from bayes_aero.physics.aircraft import AIRCRAFT_KEYS

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


def keys_of(part):
    """Every key that a schema names."""
    if isinstance(part, dict):
        own = part.get("properties", {})
        return {*(own if isinstance(own, dict) else ())}.union(*map(keys_of, part.values()))
    return set().union(*map(keys_of, part)) if isinstance(part, list) else set()


EFFECTS = [x for e in ba.CATALOGUE.values() for x in (f'id="{e.name}"', re.escape(e.claim))]
EFFECTS += [p.name for e in ba.CATALOGUE.values() for p in e.parameters]
CARD = {*AIRCRAFT_KEYS, *STANDARD_CHANNELS, *PARAMETER_KEYS, *FAMILIES, "column", "label", "unit", "required"}
CARD |= {"effects", "effect_files", "fixed", "states", "rates", "outputs"}
REFERENCE = {
    "api": set(ba.__all__) - {"__version__"},
    "effects": EFFECTS,
    "cli": ("bayes-aero identify", "bayes-aero diagnose", "--max-effects", "--noise"),
    "card": [rf"<code>{key}(</code>|\.)" for key in CARD]
    + [rf"<code>\[{section}(\.NAME)?\]</code>" for section in set(SECTIONS) - {"title", "source"}],
} | {
    f"schemas: {name}": [rf"<code>[^<]*\b{re.escape(key)}</code>" for key in keys_of(document_schema(name))]
    for name in ("results", "diagnosis", "trajectories", "qualification")
}


@pytest.mark.parametrize("page", REFERENCE)
def test_reference_lists_every_name_effect_option_and_key(site, page):
    text = unescape((site / "reference" / f"{page.split(':')[0]}.html").read_text(encoding="utf-8"))
    assert len(REFERENCE[page]) > (3 if page == "cli" else 10)
    assert [wanted for wanted in REFERENCE[page] if not re.search(wanted, text)] == []


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


def test_a_record_passes_few_files_from_command_to_page_and_all_that_is_named_is_there():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    way = text.split("## One record")[1].split("\n|")[0]
    passed = re.findall(r"`(bayes_aero/[\w/]+\.py)`", way)
    assert 15 <= len(passed) == len(set(passed)) <= 25
    named = {*passed, *re.findall(r"`((?:tests|benchmarks|docs)/[\w/]+\.(?:py|md))`", text)}
    assert [name for name in named if not (ROOT / name).is_file()] == []


# Notebooks as they are committed, and executed anew on reduced settings: one of them, by `make verify` all
FOLDER = ROOT / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
RECORDS = ROOT.parent / "shared" / "attas"
REAL = ("06", "07")  # need the real records
MACHINE = re.compile(r"(?<![\w.])/(?:home|root|tmp|work|usr|opt|var|Users)/|[A-Z]:\\")
MEGABYTE = 2**20

ALWAYS = "05"  # the quickest; `make verify` executes all
EXECUTED = [p if p.name.startswith(ALWAYS) else pytest.param(p, marks=pytest.mark.verify) for p in NOTEBOOKS]


def outputs(path: Path):
    """Every output of a notebook."""
    return [o for cell in nbformat.read(path, as_version=4).cells for o in cell.get("outputs", [])]


def assert_clean(path: Path) -> None:
    """No error, nothing on standard error, no path of the machine that ran it; pictures are left out."""
    for output in outputs(path):
        assert output["output_type"] != "error", output.get("evalue")
        assert output.get("name") != "stderr", output.get("text")
        said = [value for key, value in output.get("data", {}).items() if not key.startswith("image/")]
        for text in (*said, output.get("text", "")):
            assert not MACHINE.search(str(text)), MACHINE.search(str(text))


@pytest.mark.parametrize("number", range(1, 10))
def test_committed_with_clean_outputs_of_one_run_from_top_to_bottom(number):
    (path,) = FOLDER.glob(f"{number:02}_*.ipynb")
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    assert outputs(path)
    assert_clean(path)
    assert path.stat().st_size < MEGABYTE


@pytest.mark.recovery
@pytest.mark.parametrize("path", EXECUTED, ids=lambda path: path.stem)
def test_runs_on_reduced_settings(path, tmp_path):
    if path.name.startswith(REAL) and not RECORDS.is_dir():
        pytest.skip("the ATTAS records are not here")
    before = path.read_bytes()
    command = [sys.executable, str(FOLDER / "run.py"), "--quick", "--to", str(tmp_path), path.stem]
    settings = {"JAX_COMPILATION_CACHE_DIR": str(tmp_path / "compiled"), "JAX_PLATFORMS": "cpu"} | os.environ
    ended = subprocess.run(command, env=settings, capture_output=True, text=True, timeout=900, check=False)
    assert ended.returncode == 0, ended.stderr[-3000:]
    assert_clean(tmp_path / path.name)
    code = [cell for cell in nbformat.read(tmp_path / path.name, as_version=4).cells if cell.cell_type == "code"]
    assert all(cell.execution_count for cell in code)
    assert path.read_bytes() == before
