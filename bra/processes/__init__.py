"""Other processes: how they start, what they hear of, and when they end."""
