"""`cablequad log ...`: what can be done with a log besides replaying it."""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, TypeVar

import typer

from missions.cli.exits import FAILED, fail, make_folder, there, usage

Result = TypeVar("Result")

LogArgument = Annotated[Path, typer.Argument(help="The .mcap log of a run, whole or truncated.")]
JsonOption = Annotated[bool, typer.Option("--json", help="JSON on stdout, nothing else.")]

log_app = typer.Typer(
    help="Look into a log, check it, mend it, export it, decide it again.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
)


@log_app.command("info")
def log_info(run: LogArgument, as_json: JsonOption = False) -> None:
    """Duration, topics with their rates and gaps, result, scenario and versions of a log."""
    from logs.reading.inspect import info
    from missions.flight.terminal import info_table

    result = _of_log(info, run)
    if as_json:
        print(json.dumps(result))
    else:
        info_table(result)
    if result["damage"]:
        raise typer.Exit(FAILED)


@log_app.command("check")
def log_check(run: LogArgument, as_json: JsonOption = False) -> None:
    """Whether a log is sound: order of time, gaps, lost sequence numbers, its end. Exit code 1 where it is not."""
    from logs.reading.inspect import check as examine

    found = _of_log(examine, run)
    if as_json:
        print(json.dumps([f._asdict() for f in found]))
    else:
        for finding in found:
            print(f"{'BAD ' if finding.serious else 'note'}  {finding.text}")
        if not any(f.serious for f in found):
            print(f"{run}: sound")
    if any(f.serious for f in found):
        raise typer.Exit(FAILED)


@log_app.command("salvage")
def log_salvage(
    run: LogArgument,
    out: Annotated[Path | None, typer.Option(help="The new file; beside the old one where it is not given.")] = None,
) -> None:
    """Copy every sound record of a cut or damaged log into a new file with an index.

    Exit code 1 where something in its middle was lost.
    """
    from logs.reading.export import salvage

    target = out or run.with_name(run.name.removesuffix(".part").removesuffix(".mcap") + "-salvaged.mcap")
    kept = _of_log(lambda path: salvage(path, target), run)
    print(f"{target}: {kept.messages} messages")
    for damage in kept.damages:
        print(f"cablequad: {run}: {damage.text(kept.begin_ns)}", file=sys.stderr)
    if kept.lost:
        print(f"cablequad: {run}: {kept.lost} of {kept.messages + kept.lost} messages are lost in all", file=sys.stderr)
    if kept.damages:
        raise typer.Exit(FAILED)


@log_app.command("export")
def log_export(
    run: LogArgument,
    form: Annotated[
        str, typer.Option("--format", help="tlog (a file a vehicle), csv or parquet (a file a topic).")
    ] = "tlog",
    out: Annotated[Path, typer.Option(help="Folder for the files.")] = Path(),
) -> None:
    """Write a log as MAVLink tlogs or as tables."""
    from logs.reading import export
    from logs.reading.reader import read

    if form not in ("tlog", "csv", "parquet"):
        usage(f"--format: {form!r} given; write tlog, csv or parquet")
    make_folder(out, "--out")
    written = _of_log(lambda p: export.tlogs(p, out) if form == "tlog" else export.tables(read(p), out, form), run)
    for path in written:
        print(path)


@log_app.command("replay-control")
def log_replay_control(run: LogArgument, as_json: JsonOption = False) -> None:
    """Feed the recorded measurements through today's controller. Exit code 1 where a decision differs."""
    from missions.analysis.replay_control import redecide

    result = _of_log(redecide, run)
    first = result.first
    if as_json:
        print(json.dumps({**result._asdict(), "first": None if first is None else first._asdict()}))
    elif first is None:
        print(f"{result.decisions} decisions, all as recorded")
    else:
        print(
            f"{result.decisions} decisions; after {first.decided_before} equal ones {first.field} differs by "
            f"{first.largest:.3g} at t = {first.t_s:.3f} s; largest differences: "
            + ", ".join(f"{name} {value:.2g}" for name, value in result.largest.items() if value > 0)
        )
    if first is not None:
        raise typer.Exit(FAILED)


def _of_log(read: Callable[[Path], Result], run: Path) -> Result:
    """What `read` makes of a log; where it cannot, a line and exit code 1."""
    from logs.reading.reader import LogError

    there(run)
    try:
        return read(run)
    except LogError as error:
        fail(str(error))
    except OSError as error:
        fail(f"{error.filename or run}: {error.strerror}")


def report(
    run: LogArgument,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the page and its figures; beside the log if not given.")
    ] = None,
    at: Annotated[
        list[float] | None, typer.Option(help="Seconds since the release of a snapshot; may be given several times.")
    ] = None,
    video: Annotated[
        Path | None, typer.Option(help="Write a moving picture here as well: .gif, or .mp4 with ffmpeg.")
    ] = None,
    video_seconds: Annotated[float | None, typer.Option(help="How much of the run the moving picture shows.")] = None,
    video_speed: Annotated[float, typer.Option(help="How many times as fast.")] = 1.0,
) -> None:
    """Write a run as one HTML page with figures (PNG, PDF): the paper's Figures 2 to 5, tensions, links, verdict."""
    from logs.reading.reader import read
    from logs.views import figures
    from logs.views import report as page
    from logs.views import video as videos
    from missions.flight.terminal import telling

    there(run)
    folder = out or run.parent
    make_folder(folder, "--out")
    if video is not None:
        make_folder(video.parent, "--video")
    if not video_speed > 0:
        usage(f"--video-speed: {video_speed} given; a factor above 0 is needed")

    def write(path: Path) -> Path:
        loaded = read(path)
        drawn = figures.save(loaded, folder, at)
        target = folder / f"{path.name.removesuffix('.part').removesuffix('.mcap')}-report.html"
        target.write_text(page.page(loaded, drawn), encoding="utf-8")
        if video is not None:
            videos.save(loaded, video, video_seconds, video_speed)
        return target

    with telling(run.name) as tell:
        tell("drawing")
        target = _of_log(write, run)
    print(target)
    if video is not None:
        print(video)
