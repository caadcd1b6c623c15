"""Effects that a record cannot test: one sentence with a count for each kind of reason."""

from __future__ import annotations

import re
from collections.abc import Mapping

from bayes_aero.report.text.phrases import several

KINDS = {
    re.compile(r"channel (.+) was not recorded"): "because a channel was not recorded ({})",
    re.compile(r"channel (.+) does not move in this record"): "because a channel does not move ({})",
    re.compile(r"the model has no (.+)"): "because the model lacks a parameter ({})",
}
"""Reasons that name something, as the screening states them, and the words under which they are counted."""


def not_testable_sentences(reasons: Mapping[str, str]) -> list[str]:
    """How many effects are not testable, by kind of reason; nothing where all are.

    Args:
        reasons: by effect, why it cannot be tested.
    """
    if not reasons:
        return []
    counts: dict[str, int] = {}
    named: dict[str, dict[str, None]] = {}
    for reason in reasons.values():
        kind, things = _kind(reason)
        counts[kind] = counts.get(kind, 0) + 1
        named.setdefault(kind, {}).update(dict.fromkeys(things))
    told = [f"{n} {kind.format(several(sorted(named[kind])))}" for kind, n in counts.items()]
    are = "effects are" if len(reasons) > 1 else "effect is"
    return [f"{len(reasons)} {are} not testable on this record: {'; '.join(told)}."]


def _kind(reason: str) -> tuple[str, list[str]]:
    """Under which words a reason is counted, and the channels or parameters that it names."""
    for pattern, words in KINDS.items():
        if found := pattern.fullmatch(reason):
            return words, found[1].split(", ")
    return f"because {reason}".replace("{", "{{").replace("}", "}}"), []
