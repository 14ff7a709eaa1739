"""A curled, turning system falls freely for two seconds: what the step does to its energy."""

import numpy as np

import cablequad as cq
from cablequad.model import lie
from cablequad.model.dynamics import energy
from cablequad.model.integrate import RotorOutput

system = cq.System.paper(1)
rng = np.random.default_rng(1)
hanging = cq.State.hanging(system)
q = hanging.q + 0.1 * rng.normal(size=hanging.q.shape)
q /= np.linalg.norm(q, axis=-1, keepdims=True)
state = hanging._replace(q=q, R0=lie.exp(np.array([0.1, -0.2, 0.3])), Omega0=np.array([1.0, -2.0, 0.5]))
idle = RotorOutput(np.zeros(4), np.zeros((4, 3)))
for h in (8e-3, 4e-3, 2e-3):
    end = state
    for _ in range(round(2.0 / h)):
        end = cq.step(system, end, idle, h)
    print(f"step {1e3 * h:g} ms: energy off by {abs(energy(system, end) - energy(system, state)):.1e} J")
