"""Execute the notebooks: `python notebooks/run.py [--quick] [--to FOLDER] [NAME ...]`, all of them without a NAME.

Outputs replace the old ones, whole or not at all. `--quick` shortens records and repetitions (BAYES_AERO_QUICK=1), for
tests; `--to` writes the executed notebooks elsewhere. One that needs records which are not here is left as it is.
"""

from __future__ import annotations

import argparse
import base64
import io
import os
import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from PIL import Image

HERE = Path(__file__).resolve().parent
TIMEOUT = 1800  # s, a cell
NEEDS_RECORDS = {"06_what_the_attas_flights_say", "07_vane_position_or_delay", "08_three_axes"}
QUIET = ["--log-level=ERROR"]  # the kernel warns that it listens on this machine's own loopback
RECORDS = HERE.parents[1] / "shared" / "attas"


def notebooks(names: list[str]) -> list[Path]:
    """Notebooks whose names begin with one of `names`; all of them without one."""
    found = sorted(HERE.glob("[0-9][0-9]_*.ipynb"))
    return [path for path in found if not names or any(path.name.startswith(name) for name in names)]


def executed(path: Path) -> nbformat.NotebookNode:
    """The notebook run from top to bottom in a fresh kernel, as nothing but source and outputs."""
    notebook = nbformat.read(path, as_version=4)
    where = {"metadata": {"path": str(HERE)}}
    NotebookClient(
        notebook,
        timeout=TIMEOUT,
        startup_timeout=300,
        coalesce_streams=True,
        kernel_name="python3",
        extra_arguments=QUIET,
        resources=where,
    ).execute()
    notebook.metadata = {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)  # when it ran is no result
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if "image/png" in data:
                data["image/png"] = smaller(data["image/png"])
    return notebook


def smaller(png: str) -> str:
    """The same picture in 128 colours: a plot loses nothing that the eye sees, and two thirds of its size."""
    image = Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB")
    out = io.BytesIO()
    image.quantize(128, dither=Image.Dither.NONE).save(out, "PNG", optimize=True)
    return base64.b64encode(out.getvalue()).decode()


def main() -> int:
    parser = argparse.ArgumentParser(description="Execute the notebooks.")
    parser.add_argument("names", nargs="*", metavar="NAME", help="how a notebook's name begins, e.g. 03; none: all")
    parser.add_argument("--quick", action="store_true", help="shortened, for tests")
    parser.add_argument("--to", type=Path, default=HERE, help="folder for the executed notebooks")
    given = parser.parse_args()
    if given.quick:
        os.environ["BAYES_AERO_QUICK"] = "1"
    given.to.mkdir(parents=True, exist_ok=True)
    for path in notebooks(given.names):
        if path.stem in NEEDS_RECORDS and not RECORDS.is_dir():
            print(f"{path.name}: left as it is; it needs the ATTAS records")
            continue
        try:
            notebook = executed(path)
        except CellExecutionError as error:
            print(f"{path.name}: {error}", file=sys.stderr)
            return 1
        partial = given.to / (path.name + ".part")
        nbformat.write(notebook, partial)
        partial.replace(given.to / path.name)
        print(f"{path.name}: executed")
    return 0


if __name__ == "__main__":
    sys.exit(main())
