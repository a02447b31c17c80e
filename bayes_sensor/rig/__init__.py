"""The rig: its lags and their names, the layout of parameters, the exact response."""
