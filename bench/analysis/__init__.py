"""What every analysis shares: its material, its estimates, and the form of results.json."""
