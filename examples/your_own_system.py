"""Three unequal vehicles under a box: gains, and two seconds by hand."""

import numpy as np

import cablequad as cq
from cablequad.control.control_step import Measurement
from cablequad.control.trajectory import Reference
from cablequad.model.attitude import Setpoint, flown

box = cq.Payload(0.8, (0.02, 0.03, 0.04), [(0.4, 0.0, -0.1), (-0.3, 0.3, -0.1), (-0.3, -0.3, -0.1)])
quadrotors = [cq.Quadrotor(mass, (6e-3, 6e-3, 1e-2)) for mass in (0.7, 0.8, 0.9)]
cables = [cq.Cable([0.01] * 4, [0.2] * 4)] * 3
system = cq.System.of(box, quadrotors, cables)
airframe = cq.Airframe(np.full(3, 12.0), np.full(3, 0.9), np.full(3, 25.0))
design = cq.sampled_law(system, airframe, cq.Weights(), period=0.01, delay=1)
print(design)

state, memory = cq.State.hanging(system, (0.2, -0.1, 0.0)), cq.first_memory(design)
target = Reference(np.zeros(3), np.zeros(3))
for k in range(200):
    acts = Setpoint.attitude(memory.R_c[0], memory.f[0])
    memory, sample = cq.control_step(memory, Measurement(0.01 * k, state), target, design)
    state = flown(system, airframe, acts, state, 0.001, 10)
print(sample)
