"""The linear model of Proposition 2 against the whole one, from a small push on."""

import numpy as np
from scipy.linalg import expm

import cablequad as cq
from cablequad.analysis.margins import modes
from cablequad.model.integrate import RotorOutput

system = cq.System.paper(1)
M, G, B = cq.linearize(system)
D, n = M.shape[0], len(system.m)
found = modes(system)
slowest = min(found, key=lambda mode: abs(mode.pole))
print(f"{D} coordinates, {B.shape[1]} forces, {len(found)} modes; the slowest: {slowest.motion}")

hover = RotorOutput((system.M_iT + system.m0 / n) * system.g, np.zeros((n, 3)))
state = cq.State.hanging(system)._replace(v0=np.array([0.01, 0.0, 0.0]), omega=np.full((n, 5, 3), [0.0, 0.05, 0.0]))
for _ in range(500):
    state = cq.step(system, state, hover, 1e-3)

rates = np.zeros(D)
rates[0] = 0.01
rates[6:] = np.tile([0.0, 0.05], D // 2 - 3)  # of the links, about x and y
A = np.block([[np.zeros((D, D)), np.eye(D)], [-np.linalg.solve(M, G), np.zeros((D, D))]])
linear = expm(0.5 * A) @ np.concatenate([np.zeros(D), rates])
print(f"0.5 s after a push of 1 cm/s: load at {1e3 * state.x0[0]:.3f} mm, by the linear model {1e3 * linear[0]:.3f} mm")
