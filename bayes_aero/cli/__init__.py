"""The command line: parse, call, print; one file a command, and no science in any of them."""

from bayes_aero.cli.app import app, main

__all__ = ["app", "main"]
