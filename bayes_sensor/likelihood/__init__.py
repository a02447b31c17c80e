"""The likelihood: priors, the problem, the noise law, the density, and its compressed form."""
