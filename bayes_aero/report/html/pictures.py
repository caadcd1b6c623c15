"""Figures of a run, embedded in the page."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from pathlib import Path

from PIL import Image

from bayes_aero.report.html.page import Picture
from bayes_aero.report.style import DPI

WIDEST = 1600  # pixels; a figure for paper is drawn wider than a screen
FOLDED = 1100  # the same for one that stands behind a fold
COLOURS = 48  # of the palette: lines and text need few
CSS_INCH = 96.0  # pixels of a screen in which a font has its nominal size


class Gallery:
    """The drawn figures by stem, with captions and alternative texts."""

    def __init__(self, paths: Mapping[str, Path], texts: Mapping[str, tuple[str, str]]) -> None:
        self.paths, self.texts = paths, texts

    def __call__(self, *stems: str, widest: int = WIDEST) -> tuple[Picture, ...]:
        """The pictures of these stems that were drawn."""
        pictures = []
        for stem in (stem for stem in stems if stem in self.paths):
            (caption, alt), (source, size, natural) = self.texts[stem], embedded(self.paths[stem], widest)
            pictures.append(Picture(source, alt, caption, *size, natural))
        return tuple(pictures)

    def folded(self, *stems: str) -> tuple[Picture, ...]:
        """The pictures at a smaller size."""
        return self(*stems, widest=FOLDED)


def embedded(path: Path, widest: int = WIDEST) -> tuple[str, tuple[int, int], int]:
    """A PNG as a data URI with a palette of its own, its size (at most `widest` pixels), and its width on a screen."""
    with Image.open(path) as opened:
        image = opened.convert("RGB")
    natural = round(CSS_INCH * image.width / DPI)
    if image.width > widest:
        image = image.resize((widest, round(image.height * widest / image.width)), Image.Resampling.LANCZOS)
    small = image.quantize(COLOURS, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    buffer = io.BytesIO()
    small.save(buffer, format="png", compress_level=9)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode("ascii"), image.size, natural
