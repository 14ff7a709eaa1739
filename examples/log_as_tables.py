"""A log as pandas tables: how good the estimate of the links was, second by second."""

import numpy as np

import cablequad as cq

log = cq.fly(cq.scenario("lemniscate-fleet", duration_s=6.0), out="runs").log
estimate = log["/control/estimate"].to_pandas()
links = estimate.filter(like="link_direction_")
worst = np.degrees(links.abs().max(axis=1))
print(f"{len(estimate)} decisions, {links.shape[1]} links")
print(worst.groupby(np.floor(worst.index)).max().round(2).to_string())
