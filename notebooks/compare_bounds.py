"""Every bound method on one campaign: python compare_bounds.py CAMPAIGN.toml [bounds.png]."""

import sys
from pathlib import Path

import bayes_sensor as bs
from bayes_sensor import figures

campaign = bs.read_campaign(sys.argv[1])
fit = bs.fit_least_squares(campaign)
posterior = bs.sample_posterior(campaign, fit, sampler="independence")
bounds = bs.compare_bounds(campaign, fit, posterior)
shared = posterior.names[: posterior.layout.n_shared]  # lags and volumes
print(bounds.table().loc[shared].to_string(float_format="%.5g"))
for method, bound in bounds.methods.items():
    print(f"{method}: assumes {bound.assumes}. {bound.status}")
picture = Path(sys.argv[2] if len(sys.argv) > 2 else "bounds.png")
picture.write_bytes(figures.png(figures.intervals(bounds.to_json())))
