"""A picture of a replay without a screen: a headless viewer, asked to show one time and to save what it sees."""

import contextlib
import os
import sys
import time
from pathlib import Path

import numpy as np
from rerun.experimental import ViewerClient

from logs.reading.reader import LogError
from logs.views.replay_layout import TIMELINE

START_S = 180.0  # wall clock, of a viewer on a slow computer
LOOK_S = 0.75  # wall clock, between two pictures that are compared


def screenshots(rrd: Path, shots: dict[float, Path], port: int = 9913) -> None:
    """Save the replay at each time (s since release) to its PNG. Raises LogError if the viewer shows an error.

    Needs a Vulkan driver; a software one will do (Debian: mesa-vulkan-drivers).
    """
    os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}"
    os.environ.setdefault("RUST_LOG", "error")
    try:
        viewer = ViewerClient.spawn(headless=True, port=port, hide_welcome_screen=True)
    except RuntimeError as error:
        raise LogError(f"the Rerun viewer did not start: {str(error).splitlines()[0]}") from None
    try:
        viewer.open(str(rrd.resolve()))
        until = time.monotonic() + START_S
        while not getattr(viewer.get_state(), "views", None):
            if time.monotonic() > until:
                raise LogError(f"the Rerun viewer showed nothing of {rrd} within {START_S:.0f} s")
            time.sleep(0.2)
        for t, png in shots.items():
            viewer.set_time(TIMELINE, duration=np.timedelta64(round(t * 1e9), "ns"), play_state="paused")
            time.sleep(LOOK_S)
            reports = [str(report) for view in viewer.get_state().views for report in view.reports]
            if reports:
                raise LogError(f"the Rerun viewer reports: {reports[0]}")
            _save_settled(viewer, png)
    except (ConnectionError, RuntimeError, OSError) as error:
        why = (str(error).splitlines() or [""])[0]
        raise LogError(
            f"the Rerun viewer ended by itself ({why}); it needs a Vulkan driver, also without a screen (Debian: "
            "mesa-vulkan-drivers)"
        ) from None
    finally:
        with contextlib.suppress(ConnectionError, RuntimeError, OSError):
            viewer.quit()


def _save_settled(viewer: ViewerClient, png: Path) -> None:
    """Save what is shown once two pictures in a row are the same: how long drawing takes is the computer's affair."""
    before, until = b"", time.monotonic() + START_S
    while time.monotonic() < until:
        viewer.save_screenshot(str(png))
        shown = png.read_bytes()
        if shown == before:
            return
        before = shown
        time.sleep(LOOK_S)


LOCAL = ["--bind", "127.0.0.1"]  # the viewer listens for recordings, of this machine alone


def served(port: int) -> list[str]:
    """Arguments of the `rerun` command that serve a recording to browsers on this machine alone."""
    return ["--serve-web", *LOCAL, "--web-viewer-port", str(port), "--port", str(port + 1)]
