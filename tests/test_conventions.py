"""What every command has in common: its help, its version, where it may be called, and how it is refused."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import typer
from conftest import COMMAND, Command, cablequad, next_offset

from docs.readme import index_page
from docs.readme import page as readme
from logs.reading.reader import read
from missions.cli.main import app

ROOT = Path(__file__).parents[1]
GOLDEN = Path(__file__).parent / "golden" / "v2-paper-case-2-50hz.mcap"


def commands(of: Any, name: str = "cablequad") -> list[tuple[str, Any]]:
    """Every command by its words, groups too."""
    out = [(name, of)]
    for word, command in getattr(of, "commands", {}).items():
        out += commands(command, f"{name} {word}")
    return out


def test_the_command_says_which_version_it_is_whichever_way_it_is_called() -> None:
    code, out, _ = cablequad("--version")
    module = subprocess.run(
        [sys.executable, "-m", "cablequad", "--version"], capture_output=True, text=True, check=True
    )
    assert code == 0
    assert re.fullmatch(r"cablequad \d+\.\d+\.\d+\n", out)
    assert module.stdout == out


def test_help_shows_every_word_that_it_was_given() -> None:
    """[plan] and [faults] were taken for markup."""
    wide = os.environ | {"COLUMNS": "400"}
    found = commands(typer.main.get_command(app))
    assert len(found) > 15
    for name, command in found:
        shown = subprocess.run(
            [*COMMAND.split(), *name.split()[1:], "--help"], capture_output=True, text=True, check=True, env=wide
        ).stdout
        words = set(shown.replace("│", " ").split())
        for parameter in command.params:
            text = getattr(parameter, "help", None) or ""
            if not getattr(parameter, "hidden", False):
                assert set(text.split()) <= words, f"{name}: {parameter.name}"


def test_folders_of_the_users_are_not_taken_for_ours(tmp_path: Path) -> None:
    for name in ("missions", "logs", "bridge", "sitl"):
        (tmp_path / name).mkdir()
    (tmp_path / "logs" / "__init__.py").write_text("raise SystemExit('of the user')")
    theirs = os.environ | {"PYTHONPATH": "."}
    flown = subprocess.run(
        [COMMAND, "fly", "--duration", "0.3", "--no-replay", "--port-offset", str(next_offset())],
        cwd=tmp_path, env=theirs, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert "not judged at its end" in flown.stderr, flown.stderr
    assert "Traceback" not in flown.stderr
    bare = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    for environment in (bare, theirs):  # the current folder comes first in either
        module = [sys.executable, "-m", "cablequad", "scenarios"]
        listed = subprocess.run(module, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert "ground-to-ground" in listed.stdout, listed.stderr


def test_what_is_not_there_ends_as_a_wrong_call_whatever_it_is(tmp_path: Path) -> None:
    missing = str(tmp_path / "no.mcap")
    for words in (
        ("fly", "no-such"), ("check", "no-such"), ("replay", missing), ("report", missing), ("log", "info", missing),
        ("log", "check", missing), ("log", "export", missing), ("replay", str(GOLDEN), missing, "--save", "x.rrd"),
    ):  # fmt: skip
        code, out, err = cablequad(*words)
        assert code == 2, words
        assert out == ""
        assert len(err.splitlines()) == 1, err


def test_folders_of_what_is_written_are_made(tmp_path: Path) -> None:
    code, out, err = cablequad("log", "export", str(GOLDEN), "--out", str(tmp_path / "a" / "b"))
    assert code == 0, err
    assert all(Path(line).parent == tmp_path / "a" / "b" for line in out.splitlines())
    (tmp_path / "file").write_text("")
    for words in (
        ("replay", str(GOLDEN), "--save", str(tmp_path / "file" / "x.rrd")),
        ("replay", str(GOLDEN), "--screenshot", str(tmp_path / "file" / "x.png")),
        ("log", "export", str(GOLDEN), "--out", str(tmp_path / "file" / "x")),
        ("report", str(GOLDEN), "--out", str(tmp_path / "file")),
    ):
        code, _, err = cablequad(*words)
        assert code == 2
        assert "no folder can be made there" in err
        assert len(err.splitlines()) == 1, err


def test_a_picture_of_a_time_after_the_run_is_refused(tmp_path: Path) -> None:
    code, _, err = cablequad("replay", str(GOLDEN), "--screenshot", str(tmp_path / "x.png"), "--at", "500")
    assert code == 2
    assert re.search(r"--at 500: the run ends \d+\.\d s after its release", err)


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there always is a display")
def test_without_a_display_the_replay_says_what_works_instead() -> None:
    bare = {key: value for key, value in os.environ.items() if key not in ("DISPLAY", "WAYLAND_DISPLAY")}
    done = subprocess.run([COMMAND, "replay", str(GOLDEN)], capture_output=True, text=True, check=False, env=bare)
    assert done.returncode == 1
    assert "--serve" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_a_flight_finds_ports_that_are_free_and_says_where(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 14581))
        code, out, err = cablequad("fly", "--duration", "0.3", "--no-replay", "--out", str(tmp_path))
        assert re.search(r"ports are in use; --port-offset \d+ is taken", err)
        assert "not judged at its end" in err
        assert "FLOWN IN PART" in out
        code, out, err = cablequad("fly", "--no-replay", "--out", str(tmp_path), "--port-offset", "0")
    assert code == 3
    assert out == ""  # nothing was flown: no table of dashes, no replay
    assert "127.0.0.1:14581: Address already in use" in err.splitlines()[-1]


def test_a_program_that_flies_flies_once(tmp_path: Path) -> None:
    """Without `if __name__ == "__main__"`: the processes of a flight ran it again, and it flew in each of them."""
    program = tmp_path / "program.py"
    program.write_text(
        "from pathlib import Path\n"
        "from missions.flight.run import Options, Progress, run\n"
        "from missions.scenario import loading\n"
        "print('begun', flush=True)\n"
        "flight = loading.load('paper-case-1', duration_s=0.3)\n"
        f"summary, _ = run(flight, Options(out=Path({str(tmp_path)!r}), port_offset={next_offset()}), Progress())\n"
        "print(summary.reason)\n"
    )
    done = subprocess.run([sys.executable, str(program)], capture_output=True, text=True, check=False)
    assert done.stdout.splitlines()[0] == "begun", done.stderr
    assert done.stdout.count("begun") == 1
    assert done.stdout.count("not judged at its end") == 1
    assert len(list(tmp_path.glob("*.mcap*"))) == 1


def test_a_replay_that_is_served_ends_with_its_command(tmp_path: Path) -> None:
    port = 20000 + next_offset()
    serving = Command("replay", str(GOLDEN), "--serve", "--port", str(port), cwd=tmp_path)
    until = time.monotonic() + 60
    while not listens(port) and time.monotonic() < until:
        time.sleep(0.1)
    assert listens(port)
    assert not listens(port, "127.0.0.2")  # an address of this machine that everybody's listeners have too
    serving.process.send_signal(signal.SIGTERM)
    serving.wait(30)
    until = time.monotonic() + 5
    while listens(port) and time.monotonic() < until:
        time.sleep(0.1)
    assert not listens(port)


def listens(port: int, host: str = "127.0.0.1") -> bool:
    """Whether anybody takes connections there."""
    with socket.socket() as tried:
        tried.settimeout(1.0)
        return tried.connect_ex((host, port)) == 0


def test_the_readmes_figures_are_those_of_the_results() -> None:
    assert (ROOT / "README.md").read_text() == readme()
    assert (ROOT / "docs" / "index-page.md").read_text() == index_page()


def test_the_documentation_is_a_site_whose_links_lead_somewhere(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "docs.site", "--out", str(tmp_path / "site")], cwd=ROOT, capture_output=True, text=True,
        check=False, timeout=200,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    page = {name: (tmp_path / "site" / name / "index.html").read_text() for name in ("", "docs/scenario", "docs/model")}
    assert "docs/own-vehicles" in page[""]
    assert 'id="missionguards"' in page["docs/scenario"]
    assert page["docs/model"].count("<math") > 20
    api = (tmp_path / "site" / "docs" / "api" / "index.html").read_text()
    assert all(f"cq.{name}" in api for name in ("simulate", "fly", "flying", "read", "System", "linearize"))


def test_the_files_that_contributing_names_exist() -> None:
    root = Path(__file__).resolve().parents[1]
    named = re.findall(
        r"`((?:cablequad|bridge|sitl|logs|missions|benchmarks)/[\w/]+)(?:\.py)?`",
        (root / "CONTRIBUTING.md").read_text(),
    )
    assert len(named) > 60
    missing = [name for name in named if not (root / name).is_dir() and not (root / f"{name}.py").is_file()]
    assert [name for name in missing if "NAME" not in name] == []


def test_a_flight_goes_on_when_nobody_reads_what_it_says(tmp_path: Path) -> None:
    command = [str(COMMAND), "fly", "paper-case-1", "--no-replay", "--out", str(tmp_path)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()
    process.stderr.read(1)
    process.stderr.close()
    assert process.wait(240) == 0
    (log,) = tmp_path.glob("*.mcap")
    assert read(log).complete


@pytest.mark.alone
def test_a_terminal_that_closes_ends_a_flight_in_order(tmp_path: Path) -> None:
    command = [str(COMMAND), "fly", "paper-case-1", "--speed", "1", "--no-replay", "--out", str(tmp_path)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True)
    until = time.monotonic() + 240.0
    while not any(part.stat().st_size > 100_000 for part in tmp_path.glob("*.mcap.part")):
        assert time.monotonic() < until
        time.sleep(0.1)
    os.killpg(process.pid, signal.SIGHUP)  # as a terminal does, to all of its processes
    process.communicate(timeout=120)
    assert process.returncode == 130
    (log,) = tmp_path.glob("*.mcap")
    run = read(log)
    assert run.complete
    assert "interrupted" in run.metadata["result"]["reason"]
