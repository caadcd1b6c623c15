"""The wheel that an environment carries: pip installs it, and what it installs is this very source."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from bayes_aero.jobs.provenance import package_snapshot as made
from bayes_aero.jobs.provenance.environment import environment, write_environment

pytest.importorskip("pip", reason="pip installs the wheel")
ASK = """
import bayes_aero
from bayes_aero.flight.card.card import read_card
from bayes_aero.jobs.provenance.environment import environment
print(bayes_aero.__file__, read_card("attas").name, environment()["bayes_aero"]["source_sha256"], sep="\\n")
"""


def test_a_folder_restores_the_package(tmp_path):
    folder = write_environment(tmp_path / "results")
    wheel = folder / made.wheel_name()
    assert f"\n./{wheel.name}\n" in (folder / "requirements.txt").read_text()
    place = tmp_path / "restored"
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--no-compile"]
    subprocess.run([*pip, "--target", str(place), str(wheel)], check=True, timeout=300)
    asked = subprocess.run(
        [sys.executable, "-c", ASK],
        env=os.environ | {"PYTHONPATH": str(place)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )
    where, card, digest = asked.stdout.split()
    assert where.startswith(str(place))
    assert card == "attas"
    assert digest == environment()["bayes_aero"]["source_sha256"]
    assert (place / "bin" / "bayes-aero").is_file() or (place / "Scripts").is_dir()


def test_equal_source_makes_an_equal_wheel():
    assert made.package_wheel() == made.package_wheel()


def test_a_package_that_is_not_installed_is_named_only(tmp_path, monkeypatch):
    monkeypatch.setattr(made, "DISTRIBUTION", "bayes-aero-that-is-not-there")
    folder = write_environment(tmp_path)
    assert not list(folder.glob("*.whl"))
    assert "and bayes-aero" in (folder / "requirements.txt").read_text()
