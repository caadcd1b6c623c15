"""Cases of a study, each a line of a file: those that are there are not run again."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Hashable, Mapping
from pathlib import Path
from typing import Any

from bayes_aero.errors import InputError
from bayes_aero.inference.compiled_programs import give_back_memory

Row = dict[str, Any]


def resumed(
    path: Path, cases: Mapping[Hashable, Callable[[], Row]], key: Callable[[Row], Hashable] = lambda row: row["seed"]
) -> list[Row]:
    """Rows of the file, and of the cases that it lacks, written one by one.

    Args:
        path: the file; its folder is made.
        cases: what gives the row of each key. A case that cannot be flown is named and left out.
        key: of a row.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []
    done = {key(row) for row in rows}
    for name, case in cases.items():
        if name in done:
            continue
        try:
            rows.append(case())
        except InputError as error:
            print(f"{name}: {error}", file=sys.stderr)
            continue
        give_back_memory()  # every length of records has compiled programs of its own
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(rows[-1]) + "\n")
    return rows
