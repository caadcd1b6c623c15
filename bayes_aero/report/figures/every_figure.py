"""Every figure of a report by the stem of its file, and one function that writes them all.

A module of this folder declares its figures as `FIGURES` (of an identification) or `DIAGNOSIS_FIGURES`; no list exists.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

from matplotlib.figure import Figure

from bayes_aero.diagnosis.trajectory_result import View
from bayes_aero.errors import failure
from bayes_aero.inference.results import Identification
from bayes_aero.progress import Progress
from bayes_aero.report import figures
from bayes_aero.report.style import Drawing, NotDrawn, save

ViewFigures = Mapping[str, Callable[[View], Figure]]


def _declared(name: str) -> Iterator[Any]:
    """What every module beside this one declares under `name`."""
    for module in pkgutil.iter_modules(figures.__path__, f"{figures.__name__}."):
        if module.name != __name__:
            declared = getattr(import_module(module.name), name, None)
            if declared is not None:
                yield declared


FIGURES: dict[str, Drawing] = dict(sorted(item for found in _declared("FIGURES") for item in found.items()))
"""What an identification shows: the seed paper's nine under its numbers, then what Bayesian identification adds."""
DIAGNOSIS_FIGURES: ViewFigures = dict(item for found in _declared("DIAGNOSIS_FIGURES") for item in found.items())
"""What a diagnosis shows."""
AFTER_TRAJECTORIES = tuple(stem for found in _declared("AFTER_TRAJECTORIES") for stem in found)
"""Those of a diagnosis that need trajectories, or show them if they are there."""

Shown = TypeVar("Shown")


def write_figures(
    identification: Identification, folder: Path, progress: Progress | None = None
) -> tuple[list[Path], tuple[str, ...]]:
    """Draw every figure for which an identification holds something; see `draw_all`."""
    return draw_all(FIGURES, identification, folder, progress)


def draw_all(
    drawings: Mapping[str, Callable[[Shown], Figure]], shown: Shown, folder: Path, progress: Progress | None = None
) -> tuple[list[Path], tuple[str, ...]]:
    """Draw every figure of a registry for which `shown` holds something into `folder` as PNG.

    Returns the paths written, and for each figure that failed a sentence. A figure that fails leaves no file and does
    not keep the others from being drawn; one for which there is nothing to show is left out.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    failed: list[str] = []
    for number, (stem, draw) in enumerate(drawings.items()):
        if progress:
            progress(f"figure {stem}", number / len(drawings))
        try:
            (folder / f"{stem}.png").unlink(missing_ok=True)  # of an earlier run
            written.append(save(draw(shown), folder / f"{stem}.png"))
        except NotDrawn:
            continue
        except Exception as reason:  # whatever it is, the other figures and the results stand; it is reported by name
            failed.append(failure(f"Figure {stem} was not drawn", reason, folder.parent))
    if progress:
        progress("figures", 1.0)
    return written, tuple(failed)
