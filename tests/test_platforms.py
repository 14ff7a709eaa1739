"""What may not be there, taken away: what Linux alone has, and the packages that extras bring."""

import json
import os
import subprocess
import sys
from pathlib import Path

from conftest import COMMAND, next_offset

from logs.reading.records import entries

TAKEN = """
import fcntl, os, pathlib, select, time
for module, names in ((os, ("sched_setaffinity", "sched_getaffinity", "sched_setscheduler", "SCHED_IDLE")),
                      (select, ("epoll", "EPOLLIN")), (fcntl, ("F_SETPIPE_SZ",)), (time, ("pthread_getcpuclockid",))):
    for name in names:
        if hasattr(module, name):
            delattr(module, name)
read = pathlib.Path.read_text
def read_text(self, *a, **k):
    if str(self).startswith("/proc"):
        raise FileNotFoundError(2, "no such file", str(self))
    return read(self, *a, **k)
pathlib.Path.read_text = read_text
"""


WITHOUT = """
import sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {names}:
            raise ModuleNotFoundError("No module named " + repr(name), name=name)
sys.meta_path.insert(0, Missing())
"""
REPORT, PARQUET = {"matplotlib", "pandas", "rerun_notebook"}, {"pyarrow", "rerun"}  # rerun-sdk needs pyarrow itself


def without(folder: Path, names: set[str], *arguments: str) -> tuple[int, str, str]:
    """Run the command where some packages are not installed: exit code, stdout, stderr."""
    (folder / "sitecustomize.py").write_text(WITHOUT.replace("{names}", repr(names)))
    path = os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])
    done = subprocess.run(
        [COMMAND, *arguments], env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, timeout=200,
        check=False,
    )  # fmt: skip
    return done.returncode, done.stdout, done.stderr


def flown(folder: Path, taken: bool) -> list[tuple[str, int, bytes]]:
    """The messages of a flight over sockets, in processes that begin with (or without) what is taken away."""
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(TAKEN if taken else "")
    path = os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])
    done = subprocess.run(
        [COMMAND, "fly", "paper-case-1-50hz", "--json", "--no-replay", "--duration", "3", "--out", str(folder),
         "--port-offset", str(next_offset())],
        env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, timeout=200, check=False,
    )  # fmt: skip
    assert done.stdout, done.stderr
    assert "Traceback" not in done.stderr
    summary = json.loads(done.stdout)
    assert "not judged at its end" in summary["reason"]
    log = Path(summary["log"])
    return [(e.topic, e.log_time, e.data) for e in entries(log) if e.topic != "/perf"]


def test_a_flight_needs_nothing_that_linux_alone_has(tmp_path: Path) -> None:
    bare = flown(tmp_path / "bare", taken=True)
    assert len(bare) > 1000
    assert bare == flown(tmp_path / "whole", taken=False)


def test_flights_replays_and_logs_need_no_package_of_an_extra(tmp_path: Path) -> None:
    fly = ("fly", "paper-case-1-50hz", "--json", "--in-process", "--duration", "1", "--out", str(tmp_path))
    code, out, err = without(tmp_path, REPORT, *fly)
    assert code == 1, err  # flown in part
    summary = json.loads(out)
    assert Path(summary["replay"]).stat().st_size > 10_000
    for command in ("info", "check"):
        code, _, err = without(tmp_path, REPORT | PARQUET, "log", command, summary["log"])
        assert code == 0, err
    code, _, err = without(tmp_path, REPORT, "replay", summary["log"], "--save", str(tmp_path / "own.rrd"))
    assert code == 0, err
    code, _, err = without(tmp_path, REPORT | PARQUET, *fly, "--no-replay")
    assert code == 1, err


def test_a_command_whose_extra_is_missing_says_which(tmp_path: Path) -> None:
    log = str(Path(__file__).parent / "golden" / "v2-paper-case-2-50hz.mcap")
    code, _, err = without(tmp_path, REPORT, "report", log, "--out", str(tmp_path))
    assert (code, err) == (
        2,
        "cablequad: matplotlib is not installed; it comes with: pip install 'cablequad[report]'\n",
    )
    code, _, err = without(tmp_path, PARQUET, "log", "export", log, "--format", "parquet", "--out", str(tmp_path))
    assert (code, err) == (2, "cablequad: pyarrow is not installed; it comes with: pip install 'cablequad[parquet]'\n")


FLIES = """
import sys
import cablequad as cq
print(cq.fly("paper-case-1-50hz", out=sys.argv[1]).log_path)
"""


def test_a_log_does_not_depend_on_how_many_processors_there_are(tmp_path: Path) -> None:
    """Linear algebra in two threads adds up in another order: gains, and with them all, differed in the last bits."""
    logs = []
    for threads in ("1", "2"):
        env = {**os.environ, "OPENBLAS_NUM_THREADS": threads}
        done = subprocess.run(
            [sys.executable, "-c", FLIES, str(tmp_path / threads)], env=env, capture_output=True, text=True, timeout=200,
            check=True,
        )  # fmt: skip
        logs.append([(e.topic, e.log_time, e.data) for e in entries(Path(done.stdout.strip())) if e.topic != "/perf"])
    assert len(logs[0]) > 1000
    assert logs[0] == logs[1]
