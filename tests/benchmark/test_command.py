"""`hsvaos bench` as a user meets it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hsvaos.benchmark import outcome
from hsvaos.cli import app
from tests.benchmark.conftest import SMALL
from tests.test_cli import fails


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """The command itself, on small work."""
    monkeypatch.setattr(outcome, "PAPER", SMALL)


def test_table_file_and_comparison(
    tmp_path: Path, model: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "160")
    bench = ["bench", "--quick", "--model", str(model)]
    path = tmp_path / "new folder" / "this.json"
    run = CliRunner().invoke(app, [*bench, "-o", str(path), "--budget", "12.5"])
    assert run.exit_code == 0, run.output
    for text in ("large copy", "12.5 Hz", "share of limit", "ESTIMATE", "whole chain", "photos"):
        assert text in run.output
    assert "30 Hz" not in run.output
    record = json.loads(path.read_text())
    assert len(record["stages"]) == 10
    again = CliRunner().invoke(app, [*bench, "--compare", str(path)])
    assert again.exit_code == 0, again.output
    assert "same machine" in again.output
    assert "other / this" in again.output
    record["machine"]["cpu"] = "abacus"
    path.write_text(json.dumps(record))
    again = CliRunner().invoke(app, [*bench, "--compare", str(path)])
    assert "abacus" in again.output


def test_json_is_nothing_but_json(model: Path) -> None:
    run = CliRunner().invoke(app, ["bench", "--quick", "--model", str(model), "--json"])
    assert run.exit_code == 0
    record = json.loads(run.stdout)
    assert set(record["stages"][0]["within"]) == {"10", "15", "30"}


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--budget", "0"], "--budget must be a positive rate"),
        (["--budget", "nan"], "--budget must be a positive rate"),
        (["--device", "cuda:77"], "device 'cuda:77' is not on this machine"),
        (["--compare", "missing.json"], "missing.json"),
        (["--compare", "pyproject.toml"], "expected what `hsvaos bench -o FILE` writes"),
        (["-o", "pyproject.toml/x.json"], "expected a folder for the output, got a file"),
    ],
)
def test_bad_input_is_one_line(options: list[str], told: str) -> None:
    assert told in fails("bench", *options)
