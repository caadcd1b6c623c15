"""The program called in this process: a process of its own loads and compiles everything anew."""

import contextlib
import io
import json
import re
import sys
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

import jsonschema
import msgspec
import pytest

from bayes_aero.cli import main
from bayes_aero.flight.record import write_record
from bayes_aero.jobs.documents import DOCUMENTS, document_schema
from bayes_aero.jobs.store import plain

BLOCKS = ("Record", "Result", "Doubts", "Next")
SCREENS = ("check", "identify", "diagnose", "fly", "path", "qualify")
RINGS = 3  # a defect: to resample rings about a step of thrust, which is then called frozen in a sound record


def called(folder, *arguments):
    """What the program gives (code, out, err) that is called in this folder, for fixtures that many tests share."""
    out, err, shown = io.StringIO(), io.StringIO(), arguments[0] in SCREENS and not {"--json", "--help"} & {*arguments}
    argv = ["bayes-aero", *map(str, arguments), *(["--verbose"] if shown else [])]
    with (
        contextlib.chdir(folder),
        patch.object(sys, "argv", argv),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        pytest.raises(SystemExit) as stopped,
    ):
        main()
    if shown and stopped.value.code in (None, 0, 1, 3) and "\nAll findings\n" in out.getvalue():
        on_one_screen(out.getvalue().partition("\nAll findings\n")[0])
    return SimpleNamespace(code=stopped.value.code or 0, out=out.getvalue(), err=err.getvalue())


def on_one_screen(text):
    """At most 30 lines of 100 columns, in the four blocks, of sentences of at most 25 words."""
    lines = text.splitlines()
    assert len(lines) <= 30, text
    paths = "Results are in", "The report is in"
    assert [line for line in lines if len(line) > 100 and not line.startswith(paths)] == [], text
    blocks = {}
    for line in lines:
        if line[:9].strip() in BLOCKS:
            blocks[name := line[:9].strip()] = []
        if blocks and (line[:9].strip() in ("", name)):
            blocks[name].append(line[9:].strip())
    assert list(blocks)[:1] == ["Record"], text
    assert set(blocks) <= set(BLOCKS), text
    assert not {"Result", "Doubts"} - set(blocks), text
    for name in ("Record", "Doubts", "Next"):
        sentences = re.split(r"(?<=[.:;])\s+(?=[A-Z0-9])|(?:^|\s)(?:!|\d\.)\s", " ".join(blocks.get(name, [])))
        assert [x for x in sentences if x and len(x.split()) > 25 and "bayes-aero" not in x] == [], text


def recorded(record, path, card):
    """A file of those of the card's channels that the record has; its path."""
    write_record(record, path, [c for c in card.channels if record.has(c.name) or c.name == "time"])
    return path


def succeeded(done, *codes):
    """What a call has said that must have ended with one of these codes, 0 where none is given."""
    assert done.code in (codes or (0,)), done.out + done.err
    return done


def answer(done, *codes):
    """The JSON on standard output of such a call."""
    return json.loads(succeeded(done, *codes).out)


def refused(done, *words, gone=()):
    """Bad input is one sentence, which holds these words, and nothing is written to these paths."""
    assert (done.code, done.out) == (2, ""), done.out
    assert done.err.startswith("error: ")
    assert done.err.count("\n") == 1, done.err
    assert [word for word in words if word not in done.err] == [], done.err
    assert not [path for path in gone if Path(path).exists()]


def holds(text, *parts):
    """All of these are in it."""
    assert [part for part in parts if part not in text] == [], text


@cache
def validator(kind):
    """Of the documents of this kind, by their schema, which is one."""
    schema = document_schema(kind)
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def validated(content, kind):
    """A JSON document, or the file that holds it, that must follow the schema of its kind."""
    content = json.loads(content.read_text()) if isinstance(content, Path) else content
    assert not [error.message for error in validator(kind).iter_errors(content)]
    assert plain(msgspec.convert(content, DOCUMENTS[kind])) == content  # it is read as it was written
    return content


def page_of(folder, name="report.html"):
    """The report page without its places to break long words; every part of it must have been made."""
    page = (folder / name).read_text().replace("<wbr>", "")
    assert "was not made" not in page
    return page
