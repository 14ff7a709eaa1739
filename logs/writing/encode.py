"""Values -> the messages of each topic."""

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.timestamp_pb2 import Timestamp

from cablequad.control.control_step import Sample
from cablequad.model import lie
from cablequad.model.instant import Motion
from cablequad.model.state import Difference, link_poses
from cablequad.model.system import System
from cablequad.types import Array, Bytes, Counts
from logs.schema import cablequad_pb2 as pb
from logs.writing import layout
from logs.writing.serialize import serialized

SCHEMA_VERSION = 2  # of cablequad.proto; in a log's metadata
COLORS = (  # Okabe-Ito, told apart by colour-blind readers; vehicle i has colour i, wherever it is drawn
    (230, 159, 0), (86, 180, 233), (0, 158, 115), (204, 121, 167), (240, 228, 66), (213, 94, 0), (0, 114, 178),
)  # fmt: skip
ALARMING = frozenset({"sitl-answer-missing", "slack", "guard", "lost", "abort", "sitl-failure"})  # kinds of events
ROTOR_ARM = 0.17  # m, drawn only


class Model(NamedTuple):
    """What a log needs to know of the system to draw it."""

    system: System
    box: tuple[float, float, float]  # m, edges of the payload
    max_thrust: tuple[float, ...]  # N
    target_quat_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)  # the load's attitude at the target


def color(i: int) -> tuple[int, int, int]:
    """Vehicle i's colour, i from 0."""
    return COLORS[i % len(COLORS)]


def measured_motion(model: Model, sample: Sample, tension: Array) -> Motion:
    """Motions as a controller knows them where no simulator tells: positions by the cables, tensions at the load.

    `sample` has a row for each, as has `tension` (K, n) N.
    """
    nodes, _, _ = link_poses(model.system, sample.state)
    spread = np.repeat(tension[:, :, None], model.system.length.shape[1], axis=2)
    return Motion(sample.state, nodes[:, :, 0], np.zeros_like(nodes[:, :, 0]), spread, sample.f)


def single(value: Any) -> Any:
    """A value as one row: what `plants` and the others take, with every array and number a row of its own."""
    if isinstance(value, tuple):
        return type(value)(*(single(field) for field in value))
    return np.asarray(value)[None]


def rows(value: Any, which: Sequence[int]) -> Any:
    """Some rows of a value with a row for every instant."""
    return type(value)(*(rows(f, which) if isinstance(f, tuple) else f[which] for f in value))


def plants(boot_us: Sequence[int], restrained: Sequence[bool], m: Motion) -> list[bytes]:
    """/plant/state, of as many instants as `m` has rows."""
    s = m.state
    return serialized(pb.PlantState, len(boot_us), (
        ("sim_time_ns", [us * 1000 for us in boot_us]), ("step", [us // 1000 for us in boot_us]), ("held", restrained),
        ("payload_position", s.x0), ("payload_velocity", s.v0),
        ("payload_attitude", _quats(s.R0)), ("payload_rate", s.Omega0),
        ("quad_position", m.x), ("quad_velocity", m.v), ("quad_attitude", _quats(s.R)), ("quad_rate", s.Omega),
        ("link_direction", _grid(s.q, 34)), ("link_rate", s.omega),
        ("tension", m.tension), ("thrust", m.thrust),
    ))  # fmt: skip


def controls(
    boot_us: Sequence[int], sample: Sample, tension: Any, phase: Sequence[str], age_s: Sequence[float]
) -> list[bytes]:
    """/control/state, of as many decisions as `sample` has rows."""
    s, e = sample.state, sample.error
    return serialized(pb.ControlState, len(boot_us), (
        ("sim_time_ns", [us * 1000 for us in boot_us]), ("t", _floats(sample.t)), ("phase", phase),
        ("e_x0", e.x[:, 0:3]), ("e_v0", e.x_dot[:, 0:3]), ("Psi_0", _floats(sample.Psi_0)),
        ("e_Omega0", e.x_dot[:, 3:6]), ("Psi", sample.Psi), ("e_Omega", s.Omega),
        ("e_q", _floats(sample.e_q)), ("e_w", _floats(sample.e_omega)),
        ("ideal_force", sample.A), ("thrust", sample.f),
        ("attitude", _quats(sample.R_c)), ("under_way", sample.memory.pending), ("state_age", age_s),
        ("position", s.x0), ("velocity", s.v0), ("tension", tension),
        ("payload_attitude", _quats(s.R0)),
        ("quad_attitude", _quats(s.R)), ("link_direction", s.q),
        ("lasting", sample.memory.integral), ("calm", _floats(sample.memory.damping_share[:, 0])),
    ))  # fmt: skip


def estimates(boot_us: Sequence[int], off: Difference) -> list[bytes]:
    """/control/estimate, of as many instants as `off` has rows."""
    times = ("sim_time_ns", [us * 1000 for us in boot_us])
    return serialized(pb.EstimateError, len(boot_us), (times, *zip(off._fields, off, strict=True)))


def references(boot_us: Sequence[int], sample: Sample) -> list[bytes]:
    """/control/reference, of as many decisions as `sample` has rows."""
    r = sample.reference
    return serialized(pb.ControlReference, len(boot_us), (
        ("sim_time_ns", [us * 1000 for us in boot_us]), ("payload_position", r.x0), ("payload_velocity", r.v0),
        ("payload_attitude", _quats(sample.R_0d)), ("link_direction", sample.q_d),
        ("payload_acceleration", r.a0), ("yaw", r.yaw),
    ))  # fmt: skip


def log_line(ns: int, kind: str, subject: str, text: str) -> Any:
    """/log."""
    level = Log.Level.WARNING if kind in ALARMING else Log.Level.INFO
    return Log(timestamp=_stamp(ns), level=level, message=f"{subject}: {text}", name=kind, file="", line=0)


def scene(model: Model, epoch_ns: int) -> Any:
    """/scene: bodies that ride on the frames of /tf."""
    update = SceneUpdate()
    box = update.entities.add(timestamp=_stamp(epoch_ns), frame_id="payload", id="payload", frame_locked=True)
    box.lifetime.SetInParent()
    _cube(box, model.box, (0.35, 0.45, 0.75, 1.0))
    for i in range(len(model.system.m)):
        r, g, b = (c / 255 for c in color(i))
        name = f"quad{i + 1}"
        body = update.entities.add(timestamp=_stamp(epoch_ns), frame_id=name, id=name, frame_locked=True)
        body.lifetime.SetInParent()
        _cube(body, (2 * ROTOR_ARM, 0.04, 0.03), (r, g, b, 1.0))
        _cube(body, (0.04, 2 * ROTOR_ARM, 0.03), (r, g, b, 1.0))
        for j in range(int(model.system.n_links[i])):
            frame = _link_frame(i, j)
            link = update.entities.add(timestamp=_stamp(epoch_ns), frame_id=frame, id=frame, frame_locked=True)
            link.lifetime.SetInParent()
            _cube(link, (0.012, 0.012, float(model.system.length[i, j])), (0.85, 0.85, 0.4, 1.0))
    return update


def transforms(model: Model, m: Motion, ns: Sequence[int], first: bool) -> list[bytes]:
    """/tf: world_ned -> payload, vehicles and the middle of every link, of as many instants as `m` has rows.

    The `first` of a log has map_enu -> world_ned as well.
    """
    s, K = m.state, len(ns)
    _, middle, turn = link_poses(model.system, s)
    used = np.arange(middle.shape[2]) < model.system.n_links[:, None]
    world = np.broadcast_to(_WORLD, (K, 1, 7))
    moved = _drawn(np.concatenate([world[..., :3], s.x0[:, None], m.x, middle[:, used]], axis=1))
    turned = _drawn(np.concatenate([world[..., 3:], _quats(s.R0)[:, None], _quats(s.R), turn[:, used]], axis=1))
    turned = np.ascontiguousarray(turned[..., [1, 2, 3, 0]])
    pairs, ends = _pairs(model.system.n_links.tobytes())
    out = np.empty(len(pairs) + 120 * len(ends), np.uint8)
    messages = []
    for k, now in enumerate(ns):
        stamp = np.frombuffer(_stamp(now).SerializeToString(), np.uint8)
        skip = 0 if first and k == 0 else 1
        size = layout.transforms(stamp, pairs, ends, moved[k, skip:], turned[k, skip:], out)
        messages.append(out[:size].tobytes())
    return messages


_WORLD = np.array([0.0, 0.0, 0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5), 0.0])  # of map_enu: position and w, x, y, z


@cache
def _pairs(n_links: bytes) -> tuple[Bytes, Counts]:
    """Parent and child of every transform as they stand in it, and where each ends: world, load, vehicles, links."""
    links = np.frombuffer(n_links, np.int64).tolist()
    children = ["payload", *(f"quad{i + 1}" for i in range(len(links)))]
    children += [_link_frame(i, j) for i, k in enumerate(links) for j in range(k)]
    pairs = [("map_enu", "world_ned"), *(("world_ned", child) for child in children)]
    named = [FrameTransform(parent_frame_id=parent, child_frame_id=child) for parent, child in pairs]
    serialized_all = [message.SerializeToString() for message in named]
    return np.frombuffer(b"".join(serialized_all), np.uint8), np.cumsum([len(part) for part in serialized_all])


def _link_frame(i: int, j: int) -> str:
    return f"cable{i + 1}_link{j + 1}"


def _grid(a: Array, bits: int) -> Array:
    """To 2^-bits: doubles that end in zeros take less room in the file; 20 bits a micrometre."""
    return np.rint(a * 2.0**bits) * 2.0**-bits


def _drawn(a: Array) -> Array:
    return _grid(a, 20)


def _quats(R: Array) -> Array:
    return lie.quats_from_rotations(np.ascontiguousarray(R).reshape(-1, 3, 3)).reshape(*R.shape[:-2], 4)


def _floats(column: Any) -> list[float]:
    return column.tolist()


def _stamp(ns: int) -> Timestamp:
    return Timestamp(seconds=ns // 10**9, nanos=ns % 10**9)


def _cube(entity: Any, size: Sequence[float], rgba: Sequence[float]) -> None:
    cube = entity.cubes.add()
    cube.pose.position.SetInParent()
    cube.pose.orientation.w = 1.0
    cube.size.x, cube.size.y, cube.size.z = size
    cube.color.r, cube.color.g, cube.color.b, cube.color.a = rgba
