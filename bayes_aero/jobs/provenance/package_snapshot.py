"""This package as it runs here, changed files too, as a wheel that pip installs: without it no environment is whole."""

from __future__ import annotations

import base64
import hashlib
import io
import zipfile
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

import bayes_aero
from bayes_aero.flight.card.card import shipped_cards

DISTRIBUTION, PACKAGE = "bayes-aero", "bayes_aero"
KEPT = {".py", ".json", ".html", ".css", ".js", ".toml", ".typed"}
WRITTEN = (1980, 1, 1, 0, 0, 0)  # the earliest that an archive knows: equal files make equal wheels
WHEEL = "Wheel-Version: 1.0\nGenerator: bayes_aero\nRoot-Is-Purelib: true\nTag: py3-none-any\n"


def wheel_name() -> str:
    """The file's name, as pip wants it."""
    return f"{PACKAGE}-{bayes_aero.__version__}-py3-none-any.whl"


def package_wheel() -> bytes | None:
    """The wheel; none where the package runs without having been installed, so that what it needs is not known.

    Source: the binary distribution format of the Python Packaging User Guide.
    """
    try:
        installed = metadata.distribution(DISTRIBUTION)
    except metadata.PackageNotFoundError:
        return None
    about = f"{PACKAGE}-{bayes_aero.__version__}.dist-info"
    files = dict(_files())
    files[f"{about}/METADATA"] = (installed.read_text("METADATA") or "").encode()
    files[f"{about}/entry_points.txt"] = (installed.read_text("entry_points.txt") or "").encode()
    files[f"{about}/WHEEL"] = WHEEL.encode()
    record = [f"{name},sha256={_digest(content)},{len(content)}" for name, content in files.items()]
    files[f"{about}/RECORD"] = "\n".join([*record, f"{about}/RECORD,,", ""]).encode()
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name, WRITTEN), content, zipfile.ZIP_DEFLATED)
    return packed.getvalue()


def _files() -> Iterator[tuple[str, bytes]]:
    """What is imported and read at run time, by its place in the wheel: the shipped cards are in the package."""
    root = Path(bayes_aero.__file__).parent
    for path in sorted(root.rglob("*")):
        place = path.relative_to(root)
        if path.suffix in KEPT and path.is_file() and "__pycache__" not in place.parts and place.parts[0] != "models":
            yield f"{PACKAGE}/{place.as_posix()}", path.read_bytes()
    for path in shipped_cards().values():
        yield f"{PACKAGE}/models/{path.name}", path.read_bytes()


def _digest(content: bytes) -> str:
    return base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
