"""The figures of docs/model.md: `python -m docs.figures` (reads benchmarks/results/model.json for the timings)."""

import json
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np

from benchmarks.model import hover, swinging
from cablequad.analysis.certificate import attitude_gains, certify
from cablequad.control.design import Weights, continuous_law
from cablequad.model.attitude import Airframe
from cablequad.model.dynamics import accelerations, energy
from cablequad.model.integrate import advance, scratch
from cablequad.model.linear import linearize
from cablequad.model.state import State
from cablequad.model.system import System

HERE = Path(__file__).parent
OUT = HERE / "figures"
COLORS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7"]  # Okabe-Ito
PAPER = System.paper(1)

mpl.use("Agg")
plt.rcParams.update(
    {"font.size": 9, "axes.grid": True, "grid.alpha": 0.3, "figure.dpi": 150, "figure.constrained_layout.use": True}
)


def order() -> None:
    """Error after 0.1 s and energy drift over 10 s against the step."""
    fig, (left, right) = plt.subplots(1, 2, figsize=(7.5, 2.9))
    start, command = swinging(PAPER), hover(PAPER)

    def after(T: float, h: float) -> State:
        state = start.copy()
        advance(PAPER, state, command, h, round(T / h), scratch(PAPER, state))
        return state

    steps = np.array([4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4])
    judge = after(0.1, 1e-5)
    errors = [max(float(np.abs(a - b).max()) for a, b in zip(after(0.1, h), judge, strict=True)) for h in steps]
    left.loglog(1e3 * steps, errors, "o-", color=COLORS[0], label="measured")
    left.loglog(1e3 * steps, errors[0] * (steps / steps[0]) ** 4, "k--", lw=0.8, label="order 4")
    left.set(xlabel="step [ms]", ylabel="largest error after 0.1 s (SI units)", title="order of the step")
    left.set_xticks(1e3 * steps, [f"{1e3 * h:g}" for h in steps])
    left.minorticks_off()
    left.legend()
    for h, color in zip((2e-3, 1e-3, 5e-4), COLORS, strict=False):
        state = start.copy()
        work = scratch(PAPER, state)
        fall = hover(PAPER)._replace(thrust=np.zeros(4))
        E, drift = energy(PAPER, state), []
        for _ in range(100):
            advance(PAPER, state, fall, h, round(0.1 / h), work)
            drift.append(abs(energy(PAPER, state) - E) + 1e-16)
        right.semilogy(0.1 * np.arange(1, 101), drift, color=color, label=f"{1e3 * h:g} ms")
    right.set(xlabel="time [s]", ylabel="energy error [J]", title="free fall from a curled, turning start")
    right.legend(title="step")
    fig.savefig(OUT / "order.png")


def precision() -> None:
    """Work against precision, and cost against links."""
    results = json.loads((HERE.parent / "benchmarks" / "results" / "model.json").read_text())
    fig, (left, right) = plt.subplots(1, 2, figsize=(7.5, 2.9))
    for engine, color, marker in zip(
        ("cablequad RK4", "MuJoCo RK4", "MuJoCo implicitfast"), COLORS, "os^", strict=False
    ):
        rows = [row for row in results["precision"] if row["engine"] == engine]
        left.loglog([r["ms"] for r in rows], [r["error_m"] for r in rows], marker + "-", color=color, label=engine)
    left.set(xlabel="time for 2 s of motion [ms]", ylabel="position error at 2 s [m]", title="work against precision")
    left.set_ylim(1e-9, 100.0)
    left.legend(loc="upper right")
    line = results["linearity"]
    right.loglog(line["links"], line["step_us"], "o-", color=COLORS[0], label="cablequad, 4 cables")
    theirs = [(r["links"], r["mujoco_step_us"]) for r in results["sizes"] if r["n"] == 4 and r["mujoco_step_us"]]
    right.loglog(*zip(*theirs, strict=True), "s-", color=COLORS[1], label="MuJoCo RK4, 4 cables")
    right.set(xlabel="links a cable", ylabel="one RK4 step [us]", title="cost of a step")
    right.set_ylim(1.0, 1e5)
    right.legend(loc="upper left")
    fig.savefig(OUT / "precision.png")


def linear() -> None:
    """Poles with the right and the printed stiffness, and the tensions along a hanging cable."""
    fig, (left, right) = plt.subplots(1, 2, figsize=(7.5, 2.9))
    M, G, _ = linearize(PAPER)
    printed = G.copy()
    printed[6:, 6:] *= -1
    for matrix, color, name, marker in ((printed, COLORS[1], "as printed", "x"), (G, COLORS[0], "corrected", "o")):
        roots = np.sqrt(-np.linalg.eigvals(np.linalg.solve(M, matrix)).astype(complex))
        both = np.concatenate([roots, -roots])
        left.plot(both.real, both.imag, marker, ms=4, mfc="none", color=color, label=name)
    left.set(xlabel="real part [1/s]", ylabel="imaginary part [1/s]", title="open-loop poles: sign of G_i")
    left.legend()
    u = np.zeros((4, 3))
    for share, color in zip((1.0, 0.9, 0.6, 0.4), COLORS, strict=True):
        u[:, 2] = -share * hover(PAPER).thrust
        tension = accelerations(PAPER, State.hanging(PAPER), u).tension[0]
        right.plot(range(1, 6), tension, "o-", color=color, label=f"{100 * share:.0f} %")
    right.axhline(0.0, color="k", lw=0.8)
    right.set(xlabel="link, 1 at the vehicle", ylabel="tension [N]", title="tensions as thrust is reduced")
    right.set_ylim(-0.1, 2.6)
    right.legend(title="of hover thrust", ncols=2, loc="upper right")
    right.set_xticks(range(1, 6))
    fig.savefig(OUT / "linear.png")


def certificate() -> None:
    """The gamma - psi_1 curve for some weights of the forces."""
    fig, axis = plt.subplots(figsize=(4.6, 2.9))
    airframe = Airframe(np.full(4, 40.0), np.full(4, 0.9), np.full(4, 25.0))
    for factor, color in zip((1.0, 10.0, 100.0, 1000.0), COLORS, strict=True):
        weights = Weights()._replace(force=factor)
        design = continuous_law(PAPER, airframe, weights, 0.004, 1)
        c = certify(design, weights, attitude_gains(PAPER, airframe, 2.0))
        axis.loglog([p.psi_1 for p in c.curve], [p.gamma for p in c.curve], "o-", color=color, label=f"{factor:g}")
    axis.set(xlabel="psi_1 [-]", ylabel="largest gamma [1/s^2]", title="what Proposition 3 allows")
    axis.legend(title="force weight")
    fig.savefig(OUT / "certificate.png")


def main() -> None:
    """All figures."""
    OUT.mkdir(exist_ok=True)
    for make in (order, precision, linear, certificate):
        make()
        print(f"{make.__name__}.png")


if __name__ == "__main__":
    main()
