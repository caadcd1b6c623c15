"""Valid tables made wrong in the ways that people and fuzzers make them wrong; and a writer of TOML for them."""

from __future__ import annotations

import copy
import json
import math
from typing import Any

from hypothesis import strategies as st

ODD = (
    None, True, 0, -1, 1, 10**12, 10**30, 10**5000, 2**63, 0.5, -0.0, 1e308, 5e-324, math.nan, math.inf, -math.inf, "",
    " ", "1e999 kg", "9**9**9**9", "nan", "-1 m", "1 furlong", "ü°\u202e", "a\nb", "\x1b[31m", "../../etc/passwd",

    "/dev/zero", "[red]", "</script>", "x" * 5000, [], [[]], {}, [1, 2], ["a", "a"], {"a": {"a": {}}},
    [[[[[[[[[[[[[[[[1]]]]]]]]]]]]]]]],
)  # fmt: skip


def places(table: Any, path: tuple = ()) -> list[tuple]:
    """The way to every entry."""
    found = []
    items = table.items() if isinstance(table, dict) else enumerate(table) if isinstance(table, list) else ()
    for key, value in items:
        found += [(*path, key), *places(value, (*path, key))]
    return found


def mutated(table: dict[str, Any], changes: list[tuple[str, int, int, Any]]) -> dict[str, Any]:
    """Entries dropped, given twice under near names, retyped, swapped, wrapped."""
    table = copy.deepcopy(table)
    for kind, one, other, value in changes:
        ways = places(table)
        if not ways:
            break
        *way, last = ways[one % len(ways)]
        holder = table
        for key in way:
            holder = holder[key]
        if kind == "drop":
            del holder[last]
        elif kind == "double" and isinstance(holder, dict):
            holder[f"{last}_"] = holder[last]
        elif kind == "double":
            holder.append(holder[last])
        elif kind == "wrap":
            holder[last] = [holder[last]] if other % 2 else {str(last): holder[last]}
        elif kind == "swap":
            source: Any = table
            for key in ways[other % len(ways)]:
                source = source[key]
            holder[last] = copy.deepcopy(source)
        elif kind == "rename" and isinstance(holder, dict):
            holder[value if isinstance(value, str) else "odd"] = holder.pop(last)
        else:
            holder[last] = copy.deepcopy(value)
    return table


def changes(values=st.sampled_from(ODD)):
    """What `mutated` takes."""
    kinds = st.sampled_from(["drop", "double", "wrap", "swap", "rename", "set", "set", "set"])
    numbers = st.integers(0, 10_000)
    return st.lists(st.tuples(kinds, numbers, numbers, values), min_size=1, max_size=4)


def toml(value: Any) -> str:
    """A document with one inline value a line; whatever TOML cannot say stands there all the same."""
    return "".join(f"{_key(key)} = {_inline(inner)}\n" for key, inner in value.items())


def _key(key: Any) -> str:
    return json.dumps(str(key), ensure_ascii=False).replace("\x7f", "\\u007f")


def _inline(value: Any) -> str:
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int):
        return hex(value) if value > 2**70 else str(value)
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, str):
        return _key(value)
    if isinstance(value, list):
        return "[" + ", ".join(map(_inline, value)) + "]"
    return "{" + ", ".join(f"{_key(k)} = {_inline(v)}" for k, v in value.items()) + "}"
