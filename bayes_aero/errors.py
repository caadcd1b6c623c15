"""Exceptions with a text for the user, and the report of unexpected failures."""

from __future__ import annotations

import errno
import os
import re
import traceback
from collections.abc import Callable
from concurrent.futures import CancelledError
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

_NO_SPACE = tuple(
    getattr(errno, name) for name in ("ENOSPC", "EDQUOT", "EFBIG") if hasattr(errno, name)
)  # disk, quota, largest file allowed

ERROR = "error.txt"
"""In a folder of results: where in the program each unexpected failure happened."""

Found = TypeVar("Found")

LONGEST = 1200
"""Characters of a sentence; what a hostile file makes longer loses its middle."""

_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")


class InputError(ValueError):
    """Bad input, in one sentence: what is wrong, where (file, channel, sample), and how to correct it.

    The sentence can contain names from files and is printed on a terminal: line ends, escape sequences and signs that
    change the direction of writing are spelled out.
    """

    def __init__(self, sentence: object = "") -> None:
        super().__init__(plain_line(str(sentence)))


class DefectError(RuntimeError):
    """A defect that the program detects, in one sentence: what failed, and what can be done."""

    def __init__(self, failed: str, mend: str) -> None:
        super().__init__(plain_line(f"{failed}: a defect of the program, please report it. Until then: {mend}"))


def plain_line(text: str) -> str:
    line = _CONTROL.sub(lambda match: ascii(match[0])[1:-1], text)
    return line if len(line) <= LONGEST else f"{line[: LONGEST // 2]} ... {line[-LONGEST // 2 :]}"


def failure(what: str, reason: Exception, folder: Path | None = None, *, user_code: bool = False) -> str:
    """The sentence that `what` is not there; where in the program it failed is added to error.txt in `folder`.
    `user_code`: whether the user's own effects may have failed. The reason is raised where no more can be written."""
    if no_space(reason):
        raise reason
    where, whose = "", "the program or of the card's effect files" if user_code else "the program"
    if folder is not None:
        with suppress(OSError), (folder / ERROR).open("a", encoding="utf-8") as handle:
            handle.write("".join(traceback.format_exception(reason)) + "\n")
            where = f" with {ERROR}"
    if isinstance(reason, MemoryError) or "RESOURCE_EXHAUSTED" in str(reason):
        return plain_line(
            f"{what}: there is not enough memory for it; use fewer or shorter records. All other results are valid."
        )
    return plain_line(
        f"{what}: {type(reason).__name__}: {reason}. This is a defect of {whose}; please report it{where}. All other "
        "results are valid."
    )


def attempted(
    what: str, do: Callable[[], Found], otherwise: Found, folder: Path | None = None, *, user_code: bool = False
) -> tuple[Found, tuple[str, ...]]:
    """What `do` returns; or `otherwise`, and the sentence of `failure`. Bad input is raised as ever."""
    try:
        return do(), ()
    except (InputError, CancelledError):
        raise
    except Exception as reason:  # whatever it is, the other parts of the job stand; it is reported, and the job fails
        return otherwise, (failure(what, reason, folder, user_code=user_code),)


def no_space(error: BaseException | None) -> bool:
    """Whether an error, or what led to it, says that no more can be written; libraries keep only the words of it."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in _NO_SPACE:
            return True
        if any(f"errno = {number}," in str(error) or os.strerror(number) in str(error) for number in _NO_SPACE):
            return True
        error = error.__cause__ or error.__context__
    return False
