"""Options of the command line that are gone: one row each, told before the command line is parsed."""

from __future__ import annotations

from collections.abc import Sequence

from bayes_aero.errors import InputError

GONE: tuple[tuple[str, str, str], ...] = (
    (
        "diagnose",
        "--predictors/--no-predictors",
        "predictors are no longer compared; use --no-test-points to leave out the manoeuvres that decide what is open",
    ),
    ("fly", "--drift", "run diagnose, which says whether a parameter changed, when and by how much"),
    (
        "identify",
        "--approximate-gp",
        "Gaussian processes are exact; give shorter parts of the records (FILE@FROM:TO) or a longer --resample",
    ),
    ("run", "--verify", "run the study again with another --out and compare the two summary.csv"),
)
"""Command, option (every spelling, "--one/--no-one"), and the rest of the sentence: what to use instead."""


def refuse_gone(arguments: Sequence[str]) -> None:
    """Refuse an option that is gone, with what to use instead.

    Args:
        arguments: of the program, the command first.

    Raises:
        InputError: one of them is gone.
    """
    command, *rest = arguments or ("",)
    options = rest[: rest.index("--")] if "--" in rest else rest  # behind it are names of files
    spelled = [argument.partition("=")[0] for argument in options]
    for of, option, instead in GONE:
        for given in option.split("/"):
            if of == command and given in spelled:
                raise InputError(f"{given} of {command} is gone: {instead}")
