"""A whole analysis: its settings, its steps, and the record of all results."""
