"""Real clients against the running server, each with both personas, in processes of their own."""

import os
import shutil
import subprocess
import sys
from importlib import resources
from pathlib import Path

import pytest
from conftest import Command, wait_for_line

CLIENTS = Path(__file__).parent / "clients"
MAVPROXY = os.environ.get("CABLEQUAD_MAVPROXY") or shutil.which("mavproxy.py")


@pytest.fixture(params=["px4", "arducopter"])
def persona(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def scenario(tmp_path: Path, persona: str) -> Path:
    """Case 1's vehicles, whose estimators are quick, so that nobody waits half a minute."""
    text = (resources.files("missions") / "scenarios" / "paper-case-1.toml").read_text()
    extra = "estimator_ready_s = 2.0\n"
    if persona == "arducopter":
        extra += "parameters = { GUID_OPTIONS = 8 }\n"
    path = tmp_path / "quick.toml"
    path.write_text(text.replace("[cable]", extra + "[cable]", 1))
    return path


def flown_by(script: str, tmp_path: Path, persona: str, offset: int, *more: str) -> str:
    server = Command(
        "sitl", str(scenario(tmp_path, persona)), "--firmware", persona, "--no-load", "--speed", "1",
        "--port-offset", str(offset),
    )  # fmt: skip
    try:
        wait_for_line(server, "x real time")
        done = subprocess.run(
            [sys.executable, str(CLIENTS / script), persona, str(offset), *more],
            capture_output=True, text=True, timeout=150, check=False,
        )  # fmt: skip
    finally:
        server.interrupt()
        code, _, err = server.wait(20)
    assert done.returncode == 0, done.stdout + done.stderr
    assert code == 0
    assert [line for line in err.splitlines() if "getting ready" not in line] == []
    return done.stdout


def test_mavsdk_sees_flies_and_lands_them(tmp_path: Path, persona: str, offset: int) -> None:
    out = flown_by("with_mavsdk.py", tmp_path, persona, offset)
    for step in (
        "four autopilots", "roll 12", "goes east_m", "goes north_m", "offboard by position", "offboard by velocity",
        "goto climbs", "landed and disarmed", "done",
    ):  # fmt: skip
        assert step in out, out


def test_mavutil_sees_flies_and_lands_them(tmp_path: Path, persona: str, offset: int) -> None:
    """Over UDP for PX4, over TCP 5760 + 10 i for ArduCopter."""
    out = flown_by("with_mavutil.py", tmp_path, persona, offset)
    for step in ("four vehicles", "rolls right", "pitches down", "landed and disarmed", "done"):
        assert step in out, out


@pytest.mark.skipif(
    MAVPROXY is None, reason="no mavproxy.py on the PATH nor in CABLEQUAD_MAVPROXY; .ci/run installs it"
)
def test_mavproxy_sees_flies_and_lands_them(tmp_path: Path, persona: str, offset: int) -> None:
    assert MAVPROXY is not None
    out = flown_by("with_mavproxy.py", tmp_path, persona, offset, MAVPROXY)
    for step in ("four vehicles", "parameters complete", "rolls right", "landed and disarmed", "done"):
        assert step in out, out
