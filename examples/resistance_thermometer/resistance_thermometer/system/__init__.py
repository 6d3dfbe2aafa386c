"""The system: declaration and analysis."""
