"""A run's columns -> where everything was over time: what replay, figures and video draw."""

import json
from typing import Any, NamedTuple

import numpy as np

from cablequad.types import Array
from logs.reading.reader import LogError, Run

SCENE_HZ = 50.0


class MotionHistory(NamedTuple):
    """A run as arrays over time, from the truth where there is one, else from what was measured."""

    t: Array  # (T,) s since the release
    x0: Array  # (T, 3) m
    quat0: Array  # (T, 4) wxyz
    quads: Array  # (T, n, 3) m
    quats: Array  # (T, n, 4) wxyz
    nodes: Array  # (T, n, L + 1, 3) m, quadrotor first
    tension: Array  # (T, n, L) N
    thrust: Array  # (T, n) N
    model: dict[str, Any]  # the log's model record
    believed: Array | None  # (T, n, L + 1, 3) m: the cables as the controller took them to be; None: not told apart
    commanded: Array | None  # (T, n, 4) wxyz: attitudes asked of the vehicles; NaN before the first


def motion_of(run: Run, hz: float = SCENE_HZ) -> MotionHistory:
    """The run's motion at most `hz` times a second. Raises LogError where the log holds none."""
    if "model" not in run.metadata:
        raise LogError(f"log {run.path}: no model in it; it was not written by cablequad or is cut at its very start")
    model = {key: json.loads(value) for key, value in run.metadata["model"].items()}
    n_links, length = np.array(model["n_links"]), np.array(model["lengths_m"])
    rho = np.array(model["attachments_m"])
    n, L = length.shape
    truth = run.columns.get("/plant/state")
    source = truth if truth is not None else run.columns.get("/control/state")
    if source is None or not len(source["sim_time_ns"]):
        raise LogError(f"log {run.path}: holds no state to replay")
    ns = source["sim_time_ns"]
    rows = thin(ns, hz)
    t = (ns[rows] - run.release_ns) * 1e-9

    def of(name: str) -> Array:
        return np.asarray(source[name][rows], dtype=float)

    lengths = np.where(np.arange(L)[None, :] < n_links[:, None], length, 0.0)
    quat0 = of("payload_attitude")
    x0 = of("payload_position") if truth is not None else of("position")
    nodes = _nodes(x0, quat0, of("link_direction").reshape(-1, n, L, 3), rho, lengths)
    control, believed, commanded = run.columns.get("/control/state"), None, None
    if control is not None and len(control["sim_time_ns"]):
        at = np.clip(np.searchsorted(control["sim_time_ns"], ns[rows], side="right") - 1, 0, None)
        heard = ns[rows] >= control["sim_time_ns"][0]
        commanded = np.where(heard[:, None, None], control["attitude"][at].reshape(-1, n, 4), np.nan)
        if truth is not None:
            q = control["link_direction"][at].reshape(-1, n, L, 3)
            believed = _nodes(control["position"][at], control["payload_attitude"][at], q, rho, lengths)
            believed[~heard] = np.nan
    tension = of("tension")
    tension = tension.reshape(-1, n, L) if truth is not None else np.repeat(tension[:, :, None], L, axis=2)
    return MotionHistory(
        t, x0, quat0, nodes[:, :, 0], of("quad_attitude").reshape(-1, n, 4), nodes, tension, of("thrust"), model,
        believed, commanded,
    )  # fmt: skip


def _nodes(x0: Array, quat0: Array, q: Array, rho: Array, lengths: Array) -> Array:
    """(T, n, L + 1, 3) m: from each quadrotor along its links to the load."""
    tied = x0[:, None, :] + rotate(quat0, rho)
    steps = lengths[None, :, :, None] * q
    below = np.concatenate([np.cumsum(steps[:, :, ::-1], axis=2)[:, :, ::-1], np.zeros_like(steps[:, :, :1])], axis=2)
    return np.asarray(tied[:, :, None, :] - below)


def thin(ns: np.ndarray, hz: float) -> np.ndarray:
    """Rows at most `hz` times a second, always the first."""
    slot = (ns - ns[0]) // round(1e9 / hz)
    return np.flatnonzero(np.diff(slot, prepend=-1) > 0)


def separation(x: Array) -> Array:
    """(T,) m: between the two of n vehicles at `x` (T, n, 3) m that are closest; n is 2 at least."""
    n = x.shape[1]
    pairs = [np.linalg.norm(x[:, a] - x[:, b], axis=1) for a in range(n) for b in range(a + 1, n)]
    return np.asarray(np.min(pairs, axis=0))


def rotate(quat_wxyz: Array, v: Array) -> Array:
    """(T, k, 3): vectors v (k, 3) turned by each of the quaternions (T, 4)."""
    w, u = quat_wxyz[:, None, :1], quat_wxyz[:, None, 1:]
    cross = np.cross(u, v[None])
    return np.asarray(v[None] + 2.0 * (w * cross + np.cross(u, cross)))


def shade(share: Array) -> np.ndarray:
    """(k, 3) uint8: dark blue to yellow through teal, even in lightness (cividis' ends), for shares 0..1."""
    stops = np.array([(60, 80, 140), (70, 130, 150), (140, 170, 110), (253, 231, 60)], dtype=float)
    at = share * (len(stops) - 1)
    low = np.minimum(at.astype(int), len(stops) - 2)
    part = (at - low)[:, None]
    return np.asarray((1 - part) * stops[low] + part * stops[low + 1], dtype=np.uint8)
