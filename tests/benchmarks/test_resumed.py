"""A study that was interrupted goes on where it stopped."""

from __future__ import annotations

from functools import partial

import pytest
from studies import resumed

from bayes_aero.errors import InputError


def test_rows_that_are_there_are_not_run_again(tmp_path, capsys):
    run = []

    def case(seed):
        if seed == 3:
            raise InputError("it leaves the envelope")
        if seed == 4 and 4 not in run:
            run.append(4)
            raise KeyboardInterrupt
        run.append(seed)
        return {"seed": seed}

    path, cases = tmp_path / "study" / "rows.jsonl", {seed: partial(case, seed) for seed in (1, 2, 3, 4)}
    with pytest.raises(KeyboardInterrupt):
        resumed(path, cases)
    assert run == [1, 2, 4]
    rows = resumed(path, cases)
    assert [row["seed"] for row in rows] == [1, 2, 4]
    assert run == [1, 2, 4, 4]  # the first two once
    assert "3: it leaves the envelope" in capsys.readouterr().err
    assert len(path.read_text().splitlines()) == 3
