"""The published Monte Carlo study, computed again beside ours."""
