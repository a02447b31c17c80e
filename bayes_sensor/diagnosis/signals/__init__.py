"""What single samples show: detectors of events, lines, local misfit and the like."""
