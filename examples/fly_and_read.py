"""Fly a scenario with every byte of its MAVLink, then look into its log."""

import numpy as np

import cablequad as cq

flown = cq.fly("paper-case-1-50hz", out="runs")
print(flown)
state = flown.log["/plant/state"]
q = state["link_direction"]  # (t, n, L, 3)
print(f"{q.shape[0]} instants of {q.shape[1]} cables with {q.shape[2]} links; tension: {state.says['tension']}")
print(f"the worst link leaned by {np.degrees(np.arccos(q[..., 2].min())):.1f} deg")
print(f"replay: {flown.log.replay()}")
