"""The program called in this process: a process of its own loads and compiles everything anew."""

from __future__ import annotations

import contextlib
import io
import sys
from types import SimpleNamespace
from unittest.mock import patch

import pytest

from bayes_aero.cli import main


def called(folder, *arguments):
    """What the program gives (code, out, err) that is called in this folder, for fixtures that many tests share."""
    out, err = io.StringIO(), io.StringIO()
    argv = ["bayes-aero", *map(str, arguments)]
    with (
        contextlib.chdir(folder),
        patch.object(sys, "argv", argv),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        pytest.raises(SystemExit) as stopped,
    ):
        main()
    return SimpleNamespace(code=stopped.value.code or 0, out=out.getvalue(), err=err.getvalue())
