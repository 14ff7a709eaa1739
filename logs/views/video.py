"""A moving picture of a run: the load, cables and vehicles in space, with time and error, as GIF or MP4."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.animation import FFMpegWriter, FuncAnimation, PillowWriter
from matplotlib.figure import Figure

from logs.reading.reader import LogError, Run
from logs.views.figures import draw_space
from logs.views.motion import motion_of

FPS = 12
PIXELS = (640, 420)
DPI = 100


def save(run: Run, path: Path, seconds: float | None = None, speed: float = 1.0) -> int:
    """Write the run from its release on, `speed` times as fast, at most `seconds` of it; the number of frames.

    .gif needs nothing more; .mp4 needs ffmpeg on the path. Raises LogError for other endings or where neither works.
    """
    m = motion_of(run, 250.0)
    last = min(float(m.t[-1]), np.inf if seconds is None else seconds)
    times = np.arange(0.0, last + 1e-9, speed / FPS)
    rows = [int(np.argmin(np.abs(m.t - s))) for s in times]
    match path.suffix:
        case ".gif":
            writer: PillowWriter | FFMpegWriter = PillowWriter(fps=FPS)
        case ".mp4":
            if not FFMpegWriter.isAvailable():
                raise LogError(f"{path}: .mp4 needs ffmpeg on the path; install it or write a .gif")
            writer = FFMpegWriter(fps=FPS)
        case _:
            raise LogError(f"{path}: write a .gif or an .mp4")
    figure = Figure(figsize=(PIXELS[0] / DPI, PIXELS[1] / DPI), dpi=DPI)
    ax: Any = figure.add_axes((0.0, 0.0, 1.0, 1.0), projection="3d")
    label = figure.text(0.02, 0.94, "", family="monospace", fontsize=9)
    seen = m.nodes[rows].reshape(-1, 3)
    low, high = seen.min(axis=0) - 0.1, seen.max(axis=0) + 0.1
    target = np.array(m.model["target_m"])

    def draw(k: int) -> list[Any]:
        row = rows[k]
        ax.clear()
        ax.plot(*m.x0[rows[: k + 1]].T, color="0.6", linewidth=0.9)
        ax.plot(*[[v] for v in target], marker="+", color="#d55e00", markersize=9)
        draw_space(ax, m, row, low, high)
        off = 100 * float(np.linalg.norm(m.x0[row] - target))
        said = (
            f"t = {m.t[row]:5.2f} s    load {off:6.1f} cm from the target    thrust up to {m.thrust[row].max():.1f} N"
        )
        label.set_text(said)
        return []

    FuncAnimation(figure, draw, frames=len(rows), blit=False).save(path, writer=writer)
    return len(rows)
