"""Libraries that only some file formats need, and that not everybody has."""

from __future__ import annotations

from importlib.util import find_spec

from bayes_aero.errors import InputError

__all__ = ["require"]


def require(suffix: str, *libraries: str) -> None:
    """Refuse a file whose format needs a library that is not there.

    Args:
        suffix: of the file, as in ".mf4".
        libraries: what is imported to read it.
    """
    for library in libraries:
        if find_spec(library) is None:
            raise InputError(
                f"reading {suffix} needs {library}, which is not installed; pip install 'bayes-aero[formats]', or "
                "write the record as .csv"
            )
