"""The one exception that a user of the package is meant to read, and the failure that no stage may put up with."""

from __future__ import annotations

import errno
import os

_NO_SPACE = tuple(
    getattr(errno, name) for name in ("ENOSPC", "EDQUOT", "EFBIG") if hasattr(errno, name)
)  # disk, quota, largest file allowed


class InputError(ValueError):
    """Bad input, told in one sentence: what is wrong, where (file, channel, sample) and how to mend it."""


def no_space(error: BaseException | None) -> bool:
    """Whether an error, or what led to it, says that no more can be written; libraries keep only the words of it."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in _NO_SPACE:
            return True
        if any(f"errno = {number}," in str(error) or os.strerror(number) in str(error) for number in _NO_SPACE):
            return True
        error = error.__cause__ or error.__context__
    return False
