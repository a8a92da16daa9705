"""What the simulator is measured by: speed beside its peers, cleanliness, agreement with a second solver."""
