"""What a diagnosis is fitted to: event-locked bins, the noise floor, the binned campaign."""
