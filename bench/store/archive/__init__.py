"""The archive in the history's database: where sessions are, what was certified of them, what trials gave."""
