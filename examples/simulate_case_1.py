"""The paper's first case by the model alone, as arrays, and its figure."""

import cablequad as cq

sim = cq.simulate("paper-case-1")
print(sim)
error = sim["payload_position"][-1] - sim["target_position"][-1]
print(f"{1e3 * (error @ error) ** 0.5:.2f} mm from its target after {sim['t'][-1]:g} s")
sim.plot().savefig("case-1.png")
