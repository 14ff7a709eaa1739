"""A rotor stops while the load hangs: the same flight with what protects it, and without."""

from pathlib import Path

import cablequad as cq
from missions.analysis.drills import drills, flown, rehearsal
from missions.flight.options import Options

flight = rehearsal(cq.scenario("ground-to-ground"))
drill = drills(flight)[0]
print(f"{drill.name}: {drill.what}")
for protect in (True, False):
    summary = flown(flight, drill, protect, Options(out=Path("runs"), in_process=True))
    print(f"{'protected' if protect else 'bare':>9}: {summary.reason}; {summary.vehicles_crashed} crashed")
