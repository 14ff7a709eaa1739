"""A replay inside a notebook."""

import rerun as rr

from logs.reading.reader import Run
from logs.views.motion import motion_of
from logs.views.replay import log
from logs.views.replay_layout import layout


def show(run: Run, width: int, height: int) -> None:
    """The replay of `run` as the widget of the cell that calls it. Raises LogError where a log holds no motion."""
    import rerun_notebook  # noqa: F401  rerun without it only warns

    out = rr.RecordingStream("cablequad", recording_id=run.path.stem)
    motion = motion_of(run)
    log(out, run, motion, None)
    rr.notebook_show(
        width=width, height=height, blueprint=layout(motion, windy="/plant/wind" in run.columns), recording=out
    )
