"""The model's figures beside MuJoCo's, in one run: `python -m benchmarks.model [--out FILE]`.

Prints tables and writes them as JSON (benchmarks/results/model.json).
"""

import argparse
import importlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.peer import apply_forces, model_of, set_state
from cablequad._jit import jit
from cablequad.analysis.rollout import LoopTiming, rollout
from cablequad.control.design import Weights, continuous_law
from cablequad.control.trajectory import Reference
from cablequad.model import lie
from cablequad.model.attitude import Airframe
from cablequad.model.dynamics import (
    Accelerations,
    Workspace,
    _solve_payload,
    _sweep_down,
    _sweep_up,
    accelerate,
    energy,
    kinetic_energy,
)
from cablequad.model.integrate import RotorOutput, Scratch, advance, finish, scratch, stage
from cablequad.model.state import State, positions
from cablequad.model.system import Cable, Payload, Quadrotor, System
from missions.analysis.batch import spread

SIZES = [(4, 5), (4, 20), (4, 80), (16, 10), (64, 50)]
MUJOCO_UP_TO = 400  # links: beyond that a single step of MuJoCo takes longer than this benchmark should
console = Console(width=110)


@jit
def _evaluate(system: System, state: State, force: np.ndarray, out: Accelerations, work: Workspace, k: int) -> None:
    for _ in range(k):
        accelerate(system, state, force, out, work)


@jit
def _loop_down(system: System, state: State, w: Scratch, k: int) -> None:
    for _ in range(k):
        _sweep_down(system, state, w.force, w.work)


@jit
def _loop_payload(system: System, state: State, w: Scratch, k: int) -> None:
    for _ in range(k):
        _solve_payload(system, state, w.acc, w.work)


@jit
def _loop_up(system: System, state: State, w: Scratch, k: int) -> None:
    for _ in range(k):
        _sweep_up(system, state, w.force, w.acc, w.work)


@jit
def _loop_stage(system: System, state: State, w: Scratch, k: int) -> None:
    for _ in range(k):
        stage(system, state, w.stage, w, 1e-9, 1e-9)


@jit
def _loop_finish(system: System, state: State, w: Scratch, k: int) -> None:
    for _ in range(k):
        finish(system, state, w)


def ring(n: int, links: int) -> System:
    """n vehicles on a ring, cables of 0.75 m and 50 g in `links` pieces; the paper's own system for (4, 5)."""
    if (n, links) == (4, 5):
        return System.paper(1)
    angle = 2 * np.pi * np.arange(n) / n
    rho = np.stack([0.5 * np.cos(angle), 0.5 * np.sin(angle), np.full(n, -0.1)], axis=1)
    quadrotor = Quadrotor(0.755, (0.557e-2, 0.557e-2, 1.05e-2))
    cable = Cable([0.05 / links] * links, [0.75 / links] * links)
    return System.of(Payload(0.125 * n, (0.02 * n,) * 3, rho), [quadrotor] * n, [cable] * n)


def swinging(system: System) -> State:
    """Curled and turning a little, so that nothing is trivially zero."""
    rng = np.random.default_rng(0)
    state = State.hanging(system)
    n, L = system.length.shape
    q = state.q + 0.1 * rng.normal(size=(n, L, 3))
    q /= np.linalg.norm(q, axis=-1, keepdims=True)
    omega = 0.3 * rng.normal(size=(n, L, 3))
    omega -= np.sum(omega * q, axis=-1, keepdims=True) * q
    return state._replace(q=q, omega=omega, R0=lie.exp(np.array([0.05, -0.1, 0.2])))


def hover(system: System) -> RotorOutput:
    """Equilibrium thrust, no moment."""
    n = len(system.m)
    return RotorOutput((system.M_iT + system.m0 / n) * system.g, np.zeros((n, 3)))


def best(run: Callable[[], object], per: int, repeats: int = 5) -> float:
    """us per item: the best of several runs of `per` items."""
    times = []
    for _ in range(repeats):
        begun = time.perf_counter()
        run()
        times.append(time.perf_counter() - begun)
    return min(times) / per * 1e6


def sizes(short: bool) -> list[dict[str, Any]]:
    """One evaluation and one RK4 step with held controls, beside MuJoCo's RK4 step."""
    rows = []
    for n, links in SIZES[:2] if short else SIZES:
        system = ring(n, links)
        state, command = swinging(system), hover(system)
        work: Scratch = scratch(system, state)
        _evaluate(system, state, work.force, work.acc, work.work, 1)
        count = max(20, 200_000 // (n * links))
        evaluation = best(lambda s=system, x=state, w=work, k=count: _evaluate(s, x, w.force, w.acc, w.work, k), count)  # type: ignore[misc]
        advance(system, state.copy(), command, 1e-5, 1, work)
        count = max(10, count // 8)
        step = best(lambda s=system, x=state, w=work, c=command, k=count: advance(s, x.copy(), c, 1e-5, k, w), count)  # type: ignore[misc]
        row: dict[str, Any] = {
            "n": n,
            "links": links,
            "evaluation_us": evaluation,
            "step_us": step,
            "mujoco_step_us": None,
        }
        if n * links <= MUJOCO_UP_TO:
            model = model_of(system, 1e-5)
            data = mujoco.MjData(model)
            set_state(system, model, data, state)
            apply_forces(system, model, data, np.outer(command.thrust, [0.0, 0.0, -1.0]))
            count = max(5, 20_000 // (n * links) ** 2 * 4)
            mujoco.mj_step(model, data)
            row["mujoco_step_us"] = best(lambda m=model, d=data, k=count: mujoco.mj_step(m, d, k), count, 3)  # type: ignore[misc]
        rows.append(row)
    table = Table(title="one evaluation, one RK4 step with held controls [us]")
    for name in ("n", "links", "evaluation", "RK4 step", "MuJoCo RK4 step", "ratio"):
        table.add_column(name, justify="right")
    for row in rows:
        theirs = row["mujoco_step_us"]
        ratio = "-" if theirs is None else f"{theirs / row['step_us']:.1f}"
        shown = "-" if theirs is None else f"{theirs:.1f}"
        table.add_row(
            str(row["n"]), str(row["links"]), f"{row['evaluation_us']:.2f}", f"{row['step_us']:.2f}", shown, ratio
        )
    console.print(table)
    return rows


def linearity(short: bool) -> dict:
    """Cost against links for four cables: the exponent of a power law through 5 .. 320 links a cable."""
    counts = np.array([5, 40, 320] if short else [5, 10, 20, 40, 80, 160, 320])
    costs = []
    for links in counts:
        system = ring(4, int(links))
        state, command = swinging(system), hover(system)
        work = scratch(system, state)
        k = int(4000 // links) + 2
        costs.append(best(lambda s=system, x=state, w=work, c=command, k=k: advance(s, x.copy(), c, 1e-6, k, w), k))  # type: ignore[misc]
    exponent = float(np.polyfit(np.log(counts), np.log(costs), 1)[0])
    slope, fixed = np.polyfit(counts, costs, 1, w=1 / np.array(costs))
    off = float(np.abs((fixed + slope * counts) / costs - 1).max())
    linked = float(np.polyfit(np.log(counts), np.log(np.array(costs) - fixed), 1)[0])
    console.print(
        f"a step from {counts[0]} to {counts[-1]} links a cable: {fixed:.1f} us for vehicles and load + {slope:.3f} us "
        f"a link of each cable (within {100 * off:.0f} %); exponent of the cables' part {linked:.2f}, "
        f"of the whole {exponent:.2f}"
    )
    return {"links": counts.tolist(), "step_us": costs, "exponent": exponent, "exponent_of_cables": linked}


def precision(short: bool) -> list[dict]:
    """Error of the load's and the vehicles' positions after 2 s against wall time, ours and MuJoCo's."""
    system = System.paper(1)
    start, command = swinging(system), hover(system)
    judge = start.copy()
    advance(system, judge, command, 2.5e-5, 80_000, scratch(system, judge))
    truth = np.vstack([judge.x0[None], positions(system, judge)[:, 0]])
    rows: list[dict[str, Any]] = []
    for h in (4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4)[: 2 if short else None]:
        steps = round(2.0 / h)
        state = start.copy()
        work = scratch(system, state)
        begun = time.perf_counter()
        advance(system, state, command, h, steps, work)
        took = time.perf_counter() - begun
        ends = np.vstack([state.x0[None], positions(system, state)[:, 0]])
        rows.append(
            {"engine": "cablequad RK4", "h_ms": 1e3 * h, "error_m": float(np.abs(ends - truth).max()), "ms": 1e3 * took}
        )
        for integrator in ("RK4", "implicitfast"):
            model = model_of(system, h, integrator)
            data = mujoco.MjData(model)
            set_state(system, model, data, start)
            apply_forces(system, model, data, np.outer(command.thrust, [0.0, 0.0, -1.0]))
            begun = time.perf_counter()
            mujoco.mj_step(model, data, steps)
            took = time.perf_counter() - begun
            mujoco.mj_forward(model, data)
            ends = np.vstack([data.qpos[:3][None], [data.body(f"b{i}_0").xipos for i in range(4)]])
            error = float(np.abs(ends - truth).max())
            rows.append({"engine": f"MuJoCo {integrator}", "h_ms": 1e3 * h, "error_m": error, "ms": 1e3 * took})
    table = Table(title="work against precision: 2 s of the paper's system (n = 4, 5 links), curled and turning")
    for name in ("engine", "step [ms]", "error at 2 s [m]", "time [ms]"):
        table.add_column(name, justify="right")
    for row in sorted(rows, key=lambda r: (r["engine"], -r["h_ms"])):
        table.add_row(row["engine"], f"{row['h_ms']:g}", f"{row['error_m']:.1e}", f"{row['ms']:.2f}")
    console.print(table)
    return rows


def _flights(count: int) -> None:
    """`count` rollouts of Case 1."""
    system = System.paper(1)
    airframe = Airframe(np.full(4, 40.0), np.full(4, 0.9), np.full(4, 25.0))
    design = continuous_law(system, airframe, Weights(1, 2, 2, 1, 1, 0.1, 1), 0.004, 1)
    target = Reference(np.array([0.44, 0.78, -0.5]), np.zeros(3))
    for _ in range(count):
        for _ in rollout(
            design, airframe, lambda _: target, State.hanging(system, (1.0, 4.8, 0.0)), LoopTiming(0.004, 4, 1), 2500
        ):
            pass


def flights(short: bool) -> dict:
    """Closed loop without a wire: Case 1, 10 s, 1 ms steps, decisions at 250 Hz, law = paper; and batches of it."""
    system = System.paper(1)
    airframe = Airframe(np.full(4, 40.0), np.full(4, 0.9), np.full(4, 25.0))
    design = continuous_law(system, airframe, Weights(1, 2, 2, 1, 1, 0.1, 1), 0.004, 1)
    target = Reference(np.array([0.44, 0.78, -0.5]), np.zeros(3))
    start = State.hanging(system, (1.0, 4.8, 0.0))

    def one() -> None:
        for _ in rollout(design, airframe, lambda _: target, start, LoopTiming(0.004, 4, 1), 2500):
            pass

    one()
    alone = 10.0 / (best(one, 1, 3) * 1e-6)
    cores = os.cpu_count() or 1
    _flights(1)
    begun = time.perf_counter()
    few, many = (1, 3) if short else (10, 60)
    _flights(2 * few)
    lone = (time.perf_counter() - begun) / (2 * few)
    many_flights = importlib.import_module("benchmarks.model")._flights  # as other processes find it
    spread(many_flights, [1] * cores)

    def pooled(each: int) -> float:
        begun = time.perf_counter()
        spread(many_flights, [each] * cores)
        return time.perf_counter() - begun

    together = (pooled(many) - pooled(few)) / ((many - few) * cores)  # the processes' start taken off
    work = [scratch(system, start) for _ in range(cores)]
    states = [start.copy() for _ in range(cores)]

    def motion(k: int) -> None:
        advance(system, states[k], hover(system), 1e-3, 50_000, work[k])

    def in_turn() -> None:
        for k in range(cores):
            motion(k)

    serial = best(in_turn, 1, 3)
    with ThreadPoolExecutor(cores) as pool:
        threads = best(lambda: list(pool.map(motion, range(cores))), 1, 3)
    console.print(f"rollout of Case 1 (law = paper): {alone:.0f} x real time on one core")
    console.print(f"batches on {cores} cores, threads with the GIL released: {serial / threads:.2f} x one core")
    console.print(f"rollouts of Case 1 as {cores} processes, their start apart: {lone / together:.2f} x one process")
    return {
        "rollout_real_time_factor": alone, "cores": cores, "thread_scaling": serial / threads,
        "process_scaling": lone / together,
    }  # fmt: skip


def phases(short: bool) -> dict:
    """ns per part of one RK4 step of the paper's system: where the time goes."""
    system = System.paper(1)
    state, command = swinging(system), hover(system)
    work = scratch(system, state)
    k = 1_000 if short else 20_000
    parts = {}
    for name, loop in (
        ("sweep down (4 x)", _loop_down), ("payload's 6 x 6 (4 x)", _loop_payload), ("sweep up (4 x)", _loop_up),
        ("moving to a stage (4 x)", _loop_stage), ("finish", _loop_finish),
    ):  # fmt: skip
        loop(system, state.copy(), work, 1)
        each = 1e3 * best(lambda f=loop: f(system, state.copy(), work, k), k)  # type: ignore[misc]
        parts[name] = each * (1 if name == "finish" else 4)
    whole = 1e3 * best(lambda: advance(system, state.copy(), command, 1e-5, k, work), k)
    table = Table(title="where one RK4 step goes, n = 4, 5 links")
    table.add_column("part")
    table.add_column("ns", justify="right")
    for name, value in [*parts.items(), ("whole step", whole)]:
        table.add_row(name, f"{value:.0f}")
    console.print(table)
    return {**parts, "whole step": whole}


def drift() -> dict:
    """Energy kept over 60 s of free fall from a curled, turning start, 1 ms steps."""
    system = System.paper(1)
    state = swinging(system)
    before = energy(system, state)
    scale = kinetic_energy(system, state) + system.M_T * system.g
    idle = RotorOutput(np.zeros(4), np.zeros((4, 3)))
    advance(system, state, idle, 1e-3, 60_000, scratch(system, state))
    fallen = kinetic_energy(system, state)
    change = abs(energy(system, state) - before)
    console.print(
        f"60 s of free fall at 1 ms: energy off by {change:.1e} J of {fallen:.1e} J kinetic, {scale:.1f} J at the start"
    )
    return {"change_J": change, "kinetic_end_J": fallen, "scale_start_J": scale}


def starts(short: bool) -> dict:
    """Seconds until a command shows its first line and until it is back, with compiled code cached."""
    out = {}
    for name, arguments in (("help", ["--help"]), ("check", ["check", "paper-case-1", "--quick"])):
        firsts, wholes = [], []
        for _ in range(1 if short else 3):
            begun = time.perf_counter()
            child = subprocess.Popen([sys.executable, "-m", "missions.cli.main", *arguments], stdout=subprocess.PIPE)
            assert child.stdout is not None
            child.stdout.readline()
            firsts.append(time.perf_counter() - begun)
            child.communicate()
            wholes.append(time.perf_counter() - begun)
        out[name] = {"first_line_s": min(firsts), "whole_s": min(wholes)}
        console.print(f"cablequad {' '.join(arguments)}: first line {min(firsts):.2f} s, done {min(wholes):.2f} s")
    return out


def main() -> None:
    """All tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "model.json")
    parser.add_argument("--short", action="store_true", help="a few seconds: whether it works, not what it costs")
    given = parser.parse_args()
    out, short = given.out, given.short
    results = {
        "sizes": sizes(short),
        "linearity": linearity(short),
        "phases_ns": phases(short),
        "precision": precision(short),
        "drift": drift(),
        "flights": flights(short),
        "starts": starts(short),
    }
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(results, indent=1) + "\n")
    console.print(f"written to {out}")


if __name__ == "__main__":
    main()
