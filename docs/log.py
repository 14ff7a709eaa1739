"""Write docs/log.md from `logs/schema/cablequad.proto`: `python -m docs.log`."""

import re
from pathlib import Path

HERE = Path(__file__).parent
PROTO = HERE.parent / "logs" / "schema" / "cablequad.proto"

HEAD = """# The log

One run is one MCAP file, zstd in chunks of 512 KiB, protobuf with the schema inside. Written as `NAME.mcap.part` and
renamed at the end; closed in chunks every 0.4 s, so that a run of which all processes are killed loses half a second at
most. log_time is the scenario's epoch plus the
vehicles' clock; publish_time is the wall clock. Two runs of one scenario and seed in lockstep have equal (topic, log_time,
data), `/perf` aside.

| topic | schema | when | what |
|---|---|---|---|
| `/plant/state` | cablequad.PlantState | every tick, or `record.truth_rate_hz` | truth; only where a simulator tells it |
| `/control/state`, `/control/reference` | cablequad.ControlState, ControlReference | every decision | what was decided and why |
| `/control/estimate` | cablequad.EstimateError | every decision | how far the state that was gone by is from the true one |
| `/mavlink/quadN/rx`, `/tx`, `/mavlink/payload/rx` | cablequad.MavlinkFrame | as on the wire | raw frames, received and sent by the controller |
| `/event`, `/plant/event` | cablequad.Event | events | of the controller, of the simulator |
| `/plant/wind` | cablequad.Wind | 10 Hz | how the air moves, where it does and a simulator tells it |
| `/log`, `/plant/log` | foxglove.Log | events | the same for viewers |
| `/tf`, `/scene` | foxglove.FrameTransforms, SceneUpdate | 50 Hz, once | frames and bodies for viewers; `map_enu` is Z up |
| `/perf` | cablequad.Perf | 1 Hz | wall-clock figures |

Metadata records: `run` (scenario, seed, versions, git commit, schema_version, frame, units), `model` (what a replay draws),
`gains`, and at an orderly end `result`: its absence says that the run did not end in order. Attached: the scenario's file,
the resolved scenario as JSON, and the mission script.

| command | what it does |
|---|---|
| `cablequad log info RUN.mcap` | duration, topics with rates and gaps, result, scenario, versions |
| `cablequad log check RUN.mcap` | order of time, gaps, frames missing by their sequence numbers, a missing end; exit code 1 where something is wrong |
| `cablequad log salvage RUN.mcap` | every sound record of a cut or damaged file into a new one with an index; what is lost is counted and timed, exit code 1 where it is in the middle |
| `cablequad log export RUN.mcap --format tlog` | a .tlog for each vehicle; `csv`, `parquet`: a table for each topic |
| `cablequad log replay-control RUN.mcap` | every decision made again by today's controller, and the first that differs |

"""


def page() -> str:
    """The whole page."""
    text = PROTO.read_text(encoding="utf-8")
    top = text[: text.index("syntax =")]
    out = [HEAD, "## Fields\n\n", " ".join(line.removeprefix("// ") for line in top.splitlines() if line), "\n"]
    for comment, name, body in re.findall(r"// ([^\n]*)\nmessage (\w+) \{\n(.*?)\n\}", text, re.S):
        out.append(f"\n### {name}\n\n{comment}\n\n| field | type | shape, unit, frame |\n|---|---|---|\n")
        for line in body.splitlines():
            match = re.match(r"\s*(repeated )?(\w+) (\w+) = \d+;\s*(?://\s*(.*))?$", line)
            if match is None:
                raise ValueError(f"{PROTO.name}: a field that cannot be read: {line!r}")
            many, kind, field, said = match.groups()
            said = (said or "").replace("|", "\\|")
            out.append(f"| `{field}` | {kind}{'[]' if many else ''} | {said} |\n")
    return "".join(out)


if __name__ == "__main__":
    (HERE / "log.md").write_text(page(), encoding="utf-8")
