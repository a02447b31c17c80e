"""The evidence of explanations of the mean: refits, Laplace's approximation, rivals."""
