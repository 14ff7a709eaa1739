"""Modes, margins and losses of a scenario's loop, by the functions behind `cablequad check`."""

import cablequad as cq
from cablequad.analysis.margins import largest_loss, margins, modes

flight = cq.scenario("paper-case-1-50hz")
design = cq.design(flight)
period, delay = 1.0 / flight.scenario.control.rate_hz, flight.scenario.control.delay_ticks
weakest = modes(flight.system)[0]
print(f"reached least: {weakest.motion} at {abs(weakest.pole):.1f} rad/s, PBH {weakest.pbh:.3f}")
m = margins(design, flight.airframe, period, delay)
print(f"delay {m.delay_ms:.0f} ms, disk margin {m.disk:.2f}")
print(f"losses up to {100 * largest_loss(design, flight.airframe, period, delay):.0f} %")
