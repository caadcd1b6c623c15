"""The folder for results: it is there, and nothing in it leads elsewhere."""

from __future__ import annotations

from pathlib import Path

from bayes_aero.errors import ERROR, InputError

RESERVED = {"con", "prn", "aux", "nul", *(f"{port}{number}" for port in ("com", "lpt") for number in range(10))}
"""Names that Windows keeps for devices, whatever follows their first full stop."""


def writable(folder: Path) -> None:
    """Make the folder for results, or say why it cannot be."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        refuse_ways_out(folder)
        (folder / ERROR).unlink(missing_ok=True)  # of an earlier run
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"cannot write to {folder} ({reason}); give another folder with --out") from None


def refuse_ways_out(folder: Path) -> None:
    """Raise `InputError` for a link in `folder` that leads out of it: what is written would land there.

    The folder may be a link itself, for the user has named it.
    """
    root = folder.resolve()
    for path in sorted(folder.iterdir()) if folder.is_dir() else []:
        if path.is_symlink() and not path.resolve().is_relative_to(root):
            raise InputError(f"{path} is a link that leads out of {folder}; remove it, or give another --out")


def safe_name(words: str) -> str:
    """`words` as the beginning of a file's name on every system: no leading full stop or dash, no device of Windows."""
    words = words.lstrip(".-")
    return f"_{words}" if words.split(".")[0].split("-")[0].lower() in RESERVED else words
