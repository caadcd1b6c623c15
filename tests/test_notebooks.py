"""The notebooks as they are committed, and executed anew on reduced settings: one of them, by `make verify` all."""

import os
import re
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest

FOLDER = Path(__file__).resolve().parents[1] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
RECORDS = FOLDER.parents[1] / "shared" / "attas"
REAL = ("06", "07")  # need the real records
MACHINE = re.compile(r"(?<![\w.])/(?:home|root|tmp|work|usr|opt|var|Users)/|[A-Z]:\\")
MEGABYTE = 2**20

each = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
ALWAYS = "05"  # the quickest; `make verify` executes all
EXECUTED = [p if p.name.startswith(ALWAYS) else pytest.param(p, marks=pytest.mark.verify) for p in NOTEBOOKS]


def outputs(path: Path):
    """Every output of a notebook."""
    return [o for cell in nbformat.read(path, as_version=4).cells for o in cell.get("outputs", [])]


def texts(output) -> list[str]:
    """What an output says in words or markup; pictures are left out."""
    said = [value for key, value in output.get("data", {}).items() if not key.startswith("image/")]
    return [str(part) for part in (*said, output.get("text", ""))]


def assert_clean(path: Path) -> None:
    """No error, nothing on standard error, no path of the machine that ran it."""
    for output in outputs(path):
        assert output["output_type"] != "error", output.get("evalue")
        assert output.get("name") != "stderr", output.get("text")
        for text in texts(output):
            assert not MACHINE.search(text), MACHINE.search(text)


def test_all_are_there():
    assert [path.name[:2] for path in NOTEBOOKS] == ["01", "02", "03", "04", "05", "06", "07", "08", "09"]


@each
def test_committed_with_clean_outputs_of_one_run_from_top_to_bottom(path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    assert outputs(path)
    assert_clean(path)
    assert path.stat().st_size < MEGABYTE


@each
def test_every_figure_is_followed_by_what_it_does_not_show(path):
    cells = nbformat.read(path, as_version=4).cells
    for number, cell in enumerate(cells):
        if any("image/png" in o.get("data", {}) for o in cell.get("outputs", [])):
            words = next((c.source for c in cells[number + 1 :] if c.cell_type == "markdown"), "")
            said = " ".join(words.split())
            assert "not conclude" in said or "before anything is believed" in cells[number - 1].source


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """A folder for compiled programs that the notebooks share, unless there is one already."""
    return os.environ.get("JAX_COMPILATION_CACHE_DIR") or str(tmp_path_factory.mktemp("compiled"))


@pytest.mark.recovery
@pytest.mark.parametrize("path", EXECUTED, ids=lambda path: path.stem)
def test_runs_on_reduced_settings(path, tmp_path, compiled):
    if path.name.startswith(REAL) and not RECORDS.is_dir():
        pytest.skip("the ATTAS records are not here")
    before = path.read_bytes()
    command = [sys.executable, str(FOLDER / "run.py"), "--quick", "--to", str(tmp_path), path.stem]
    settings = os.environ | {"JAX_COMPILATION_CACHE_DIR": compiled, "JAX_PLATFORMS": "cpu"}
    ended = subprocess.run(command, env=settings, capture_output=True, text=True, timeout=900, check=False)
    assert ended.returncode == 0, ended.stderr[-3000:]
    assert_clean(tmp_path / path.name)
    code = [cell for cell in nbformat.read(tmp_path / path.name, as_version=4).cells if cell.cell_type == "code"]
    assert all(cell.execution_count for cell in code)
    assert path.read_bytes() == before
