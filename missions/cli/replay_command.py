"""`cablequad replay`: a run in the viewer, in a browser, in a file, or as a picture."""

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from missions.cli.exits import fail, make_folder, there, usage

if TYPE_CHECKING:
    from logs.reading.reader import Run

TICK_S = 0.1  # after the last thing that a log says it is shown still
CLOSING_S = 5.0  # for a viewer that is told to end


def replay(
    run: Annotated[Path, typer.Argument(help="The .mcap log of a run, whole or truncated.")],
    other: Annotated[Path | None, typer.Argument(help="A second run, drawn as a ghost beside the first.")] = None,
    save: Annotated[Path | None, typer.Option(help="Write the replay here instead of opening the viewer.")] = None,
    screenshot: Annotated[Path | None, typer.Option(help="Save a picture here instead, without a screen.")] = None,
    at: Annotated[float, typer.Option(help="Time of the picture, in seconds since the release.")] = 0.0,
    serve: Annotated[bool, typer.Option("--serve", help="Serve it to web browsers on 127.0.0.1 until Ctrl-C.")] = False,
    port: Annotated[int, typer.Option(help="With --serve: the page's port; the next one carries the data.")] = 9090,
) -> None:
    """Open a run in Rerun (two side by side), save it as an .rrd, serve it to a browser, or save a picture of it."""
    for path in (run, *([] if other is None else [other])):
        there(path)
    for option, target in (("--save", save), ("--screenshot", screenshot)):
        if target is not None:
            make_folder(target.parent, option)
    if save is None and screenshot is None and not serve:
        _display()
    with contextlib.ExitStack() as stack:
        target = save
        if target is None:
            target = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="cablequad-"))) / f"{run.stem}.rrd"
        ends_s = _write(run, other, target)
        if screenshot is not None:
            if not at <= ends_s + TICK_S:
                usage(f"--at {at:g}: the run ends {ends_s:.1f} s after its release")
            _picture(target, at, screenshot)
        elif save is not None:
            print(target)
        else:
            _view(target, port if serve else None)


def _display() -> None:
    """End where the viewer's window has nowhere to be."""
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        fail("no display for the viewer's window; --serve shows it in a browser, --screenshot and --save need none")


def _write(run: Path, other: Path | None, target: Path) -> float:
    """Write the replay; s from its release to its end. What a log has lost is told."""
    from logs.reading.reader import LogError, read
    from logs.views import replay as replays

    try:
        loaded = read(run)
        second = None if other is None else read(other)
        replays.save(loaded, target, second)
    except LogError as error:
        fail(str(error))
    except OSError as error:
        fail(f"{target}: {error.strerror}; give another path")
    for log in (loaded, *([] if second is None else [second])):
        if not log.complete:
            print(f"cablequad: {log.path}: the log is cut short; replaying what it holds", file=sys.stderr)
        for damage in log.damages:
            print(f"cablequad: {log.path}: {damage.text(log.epoch_ns)}; replaying the rest", file=sys.stderr)
    return _ends_s(loaded)


def _ends_s(run: "Run") -> float:
    last = max(
        (int(table["sim_time_ns"][-1]) for table in run.columns.values() if len(table["sim_time_ns"])), default=0
    )
    return (last - run.release_ns) * 1e-9


def _picture(replay: Path, at: float, png: Path) -> None:
    from logs.reading.reader import LogError
    from logs.views.screenshot import screenshots

    try:
        screenshots(replay, {at: png})
    except LogError as error:
        fail(str(error))
    print(png)


def _view(target: Path, port: int | None) -> NoReturn:
    """Open a replay in the viewer, or serve it to browsers from `port` on, until the user has seen enough."""
    from logs.views.screenshot import LOCAL, served

    viewer = [str(Path(sys.executable).parent / "rerun"), str(target), *(LOCAL if port is None else served(port))]
    try:
        shown = subprocess.Popen(viewer, start_new_session=True)
    except OSError as error:
        fail(f"the Rerun viewer did not start ({error.strerror}); save the replay with --save and open it elsewhere")
    try:
        code = shown.wait()
    except KeyboardInterrupt:
        code = 0
    finally:  # the command is a script that starts the viewer: both end
        with contextlib.suppress(ProcessLookupError):
            os.killpg(shown.pid, signal.SIGTERM)
            shown.wait(CLOSING_S)
    raise typer.Exit(code)
