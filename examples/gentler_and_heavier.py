"""One scenario with other numbers in it: how thrust follows the load's mass."""

from pathlib import Path
from tempfile import TemporaryDirectory

import cablequad as cq
from missions.scenario.loading import text

with TemporaryDirectory() as folder:
    for mass in (0.5, 1.0, 1.5):
        path = Path(folder) / f"load-{mass}.toml"
        path.write_text(text("paper-case-1").replace("mass_kg = 0.5\n", f"mass_kg = {mass}\n"))
        sim = cq.simulate(cq.scenario(path), duration_s=3.0)
        print(f"{mass} kg: at most {sim['thrust'].max():.2f} N, e_q at most {sim['e_q'].max():.2f}")
