"""What is compiled is compiled once, by all cores, before the first command needs it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from cablequad import _jit
from missions.cli import main as cli
from missions.cli import options
from missions.flight import compiled
from missions.flight.compiled import Part

TESTS = Path(__file__).parent


def test_a_warm_up_compiles_all_that_commands_use() -> None:
    done = subprocess.run(
        [sys.executable, str(TESTS / "warmed.py")], capture_output=True, text=True, timeout=600, check=True
    )
    assert done.stdout == ""


def warmed(monkeypatch: pytest.MonkeyPatch, mark: Path, *parts: Part) -> None:
    """What a command does first, where these parts are all that there is to compile."""
    monkeypatch.setattr(_jit, "_MARK", mark)
    monkeypatch.setattr(compiled, "LARGE", parts)
    monkeypatch.setattr(compiled, "REST", (Part("the rest", print, ("",)),))
    options.compiled()


def test_the_first_command_compiles_and_the_second_does_not(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    part = Part("the model", print, ("",))
    warmed(monkeypatch, tmp_path / "all" / "cpu", part)
    said = [line for line in capsys.readouterr().err.splitlines() if not line.endswith(" s)")]
    assert said[0] == "cablequad: first start: compiling, once: 0 of 2 done; now the model"
    assert said[-1] == "cablequad: first start: compiling, once: 1 of 2 done; now the rest"
    warmed(monkeypatch, tmp_path / "all" / "cpu", part)
    assert capsys.readouterr().err == ""
    warmed(monkeypatch, tmp_path / "all" / "another cpu", part)
    assert capsys.readouterr().err != ""


def test_where_compiling_fails_a_command_goes_on_and_the_next_one_tries_again(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    mark = tmp_path / "all" / "cpu"
    warmed(monkeypatch, mark, Part("what ends its process", os.abort, ()))
    assert not mark.exists()
    with pytest.raises(typer.Exit) as ended:
        cli.warm_up()
    assert ended.value.exit_code == 1
    assert not mark.exists()


def test_where_nothing_can_be_kept_nothing_is_compiled_beforehand(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(_jit, "_MARK", None)
    options.compiled()
    assert capsys.readouterr().err == ""
