"""What MkDocs cannot do by itself: pages written from the code, the notebooks as pages, formulas without a network.

A line that ends in `<!-- generate: NAME -->` is replaced by the markdown that the function of that name here returns;
what stands before it is for whoever reads the file itself.
"""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
GENERATE = re.compile(r"^.*<!-- generate: (\w+) -->$", re.MULTILINE)
FORMULA = re.compile(r"\$\$(.+?)\$\$|\$([^$\n]+?)\$", re.DOTALL)
WITH_FORMULAS = ("explanation/", "reference/card.md")  # elsewhere a dollar is a shell's
NOTES = re.compile(r"^<!-- (run|file [\w.]+) -->\n", re.MULTILINE)  # for tests/test_docs.py


@event_priority(100)  # before the notebook plugin looks for notebooks
def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add notebooks/*.ipynb, which live beside the docs."""
    for path in sorted((ROOT / "notebooks").glob("[0-9][0-9]_*.ipynb")):
        files.append(File(f"notebooks/{path.name}", str(ROOT), config.site_dir, config.use_directory_urls))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Fill in what is generated; turn formulas into MathML, which browsers draw by themselves."""
    source = page.file.src_uri
    markdown = GENERATE.sub(lambda found: GENERATED[found[1]](), markdown)
    markdown = NOTES.sub("", markdown)
    return FORMULA.sub(_formula, markdown) if source.startswith(WITH_FORMULAS) else markdown


def _formula(found: re.Match[str]) -> str:
    block = found[1] is not None
    return convert((found[1] or found[2]).strip(), display="block" if block else "inline")


def effects() -> str:
    """The catalogue: a table, and each effect with its parameters."""
    from bayes_aero import CATALOGUE

    order = sorted(CATALOGUE.values(), key=lambda e: (e.kind.value, e.name))
    rows = [(f"[`{e.name}`](#{e.name})", e.kind.value, e.claim, ", ".join(p.name for p in e.parameters)) for e in order]
    said = [f"{len(order)} effects.\n", _table(("effect", "kind", "claim", "parameters"), rows)]
    for e in order:
        said.append(f"\n### `{e.name}` {{ #{e.name} }}\n\n{e.claim}\n")
        said.append(f"`{_plain(e.formula)}`\n")
        if e.parameters:
            head = ("parameter", "unit", "what it is", "absent at", "start", "bounds", "prior", "worth modelling from")
            said.append(_table(head, [_parameter(e, p) for p in e.parameters]))
        facts = [f"stage {e.stage.name.lower()}", "reads " + (", ".join(e.channels) or "nothing")]
        facts += [f"acts on the {e.axes[0]} axis"] if len(e.axes) == 1 else []
        facts += ["uses " + ", ".join(e.uses)] if e.uses else []
        facts += [] if e.candidate else ["for cards only: diagnosis does not propose it"]
        said.append(f"\n{'; '.join(facts)}. Source: {e.source.rstrip('.')}.\n")
    return "\n".join(said)


def _parameter(effect: Any, p: Any) -> tuple[str, ...]:
    low, high = (_number(x) for x in p.bounds)
    bounds = "none" if (low, high) == ("-∞", "∞") else f"{low} to {high}"
    prior = f"{p.prior.family}({_number(p.prior.location)}, {_number(p.prior.scale)}); {p.prior.source}"
    least = _number(effect.sizes[p.name][0])
    return f"`{p.name}`", p.unit, p.description, _number(p.neutral), _number(p.start), bounds, prior, least


def channels() -> str:
    """Channels that the program knows."""
    from bayes_aero.flight.channel import STANDARD_CHANNELS

    rows = [
        (f"`{c.name}`", c.unit, c.description, f"{_number(c.plausible[0])} to {_number(c.plausible[1])}")
        for c in STANDARD_CHANNELS.values()
    ]
    return _table(("channel", "unit inside", "what it is", "refused outside"), rows)


def units() -> str:
    """Spellings of units."""
    from bayes_aero.units import EXACT, FOLDED

    spelled: dict[str, list[str]] = {}
    for word, meant in sorted([*FOLDED.items(), *EXACT.items()]):
        for unit in meant:
            spelled.setdefault(unit, []).extend([] if word in (unit, *spelled.get(unit, ())) else [word])
    rows = [(f"`{unit}`", ", ".join(f"`{word}`" for word in others)) for unit, others in sorted(spelled.items())]
    return _table(("unit", "also"), rows)


def aircraft() -> str:
    """Keys of [aircraft]."""
    from bayes_aero.physics.aircraft import AIRCRAFT_KEYS, OPTIONAL

    instead = {"half_span": "yes, or `span`", "span": "yes, or `half_span`"}
    rows = [
        (f"`{key}`", unit, instead.get(key, "no" if key in OPTIONAL else "yes")) for key, unit in AIRCRAFT_KEYS.items()
    ]
    return _table(("key", "dimension of", "required"), rows)


def tolerances() -> str:
    """Bands that hold where a card has none."""
    from bayes_aero.flight.record import TOLERANCES

    return _table(
        ("output", "half width, SI", "source"), [(f"`{k}`", _number(t.value), t.source) for k, t in TOLERANCES.items()]
    )


def envelope() -> str:
    """Ranges that hold where a card has none."""
    from bayes_aero.physics.aircraft import DEFAULT_RANGES, UNITS

    rows = [
        (f"`{name}`", UNITS[name], *("" if math.isinf(x) else _number(x) for x in pair))
        for name, pair in DEFAULT_RANGES.items()
    ]
    return _table(("quantity", "SI", "least", "greatest"), rows)


def results_schema() -> str:
    """results.json."""
    return _schema("results")


def diagnosis_schema() -> str:
    """diagnosis.json."""
    return _schema("diagnosis")


def trajectories_schema() -> str:
    """trajectories.json."""
    return _schema("trajectories")


def qualification_schema() -> str:
    """qualification.json."""
    return _schema("qualification")


def _schema(name: str) -> str:
    from bayes_aero.jobs.documents import document_schema

    schema = document_schema(name)
    rows: list[tuple[str, str, str]] = []
    _walk(schema, "", schema["$defs"], rows)
    text = json.dumps(schema, indent=2, ensure_ascii=False)
    full = f'??? note "The schema itself, `bayes_aero.jobs.documents.document_schema({name!r})`"\n\n    ```json\n'
    full += "".join(f"    {line}\n" for line in text.splitlines()) + "    ```\n"
    return f"{schema['description']}\n\n{_table(('key', 'type', 'what it is'), rows)}\n\n{full}"


def _walk(part: dict[str, Any], path: str, parts: dict[str, Any], rows: list[tuple[str, str, str]]) -> None:
    """Every property below `part`; `*` stands for any name, `{a, b}` for one of these, `[]` for each item."""
    required = part.get("required", [])
    named = {key: {} for key in required} | part.get("properties", {})
    if isinstance(part.get("additionalProperties"), dict):
        names = part.get("propertyNames", {}).get("enum")
        named["{" + ", ".join(names) + "}" if names else "*"] = part["additionalProperties"]
    for key, stated in named.items():
        below = _whole(stated, parts)
        optional = "" if key in required or not key.isidentifier() else " *(optional)*"
        rows.append((f"`{path}{key}`{optional}", _type(below, parts), below.get("description", "")))
        _walk(below, f"{path}{key}.", parts, rows)
    if isinstance(part.get("items"), dict):
        _walk(_whole(part["items"], parts), f"{path.rstrip('.')}[].", parts, rows)


def _whole(part: dict[str, Any], parts: dict[str, Any]) -> dict[str, Any]:
    """A part of a schema with what it refers to, and with the one of its alternatives that is not null."""
    for one in part.get("anyOf", ()):
        part = one | part if one.get("type") != "null" else part
    return parts[part["$ref"].rsplit("/", 1)[-1]] | part if "$ref" in part else part


def _type(part: dict[str, Any], parts: dict[str, Any]) -> str:
    if "anyOf" in part:
        return " or ".join(_type(_whole(one, parts), parts) for one in part["anyOf"])
    if "enum" in part:
        return ", ".join(f"`{x}`" for x in part["enum"])
    if "prefixItems" in part:
        return f"{len(part['prefixItems'])} of {_type(part['prefixItems'][0], parts)}"
    kind, items = part.get("type", ""), part.get("items")
    inner = _type(_whole(items, parts), parts) if isinstance(items, dict) else ""
    return f"{kind} of {inner}" if inner else kind


def cli() -> str:
    """Commands and options, as typer documents them."""
    import typer.main
    from typer.cli import get_docs_for_click

    from bayes_aero.cli import app

    command = typer.main.get_command(app)
    with command.make_context("bayes-aero", ["--help"], resilient_parsing=True) as context:
        return get_docs_for_click(obj=command, ctx=context, name="bayes-aero", indent=1)  # type: ignore[arg-type]


SCHEMAS = (results_schema, diagnosis_schema, trajectories_schema, qualification_schema)
GENERATED = {f.__name__: f for f in (effects, channels, units, aircraft, tolerances, envelope, *SCHEMAS, cli)}


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [head, tuple("---" for _ in head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in lines) + "\n"


def _plain(text: str | None) -> str:
    return " ".join((text or "").split()).rstrip(".")


def _number(x: float) -> str:
    if math.isinf(x):
        return "∞" if x > 0 else "-∞"
    return f"{x:.6g}"
