"""Ways of people to a run: commands, questions, notices."""
