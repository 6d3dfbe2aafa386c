"""How people reach a run: commands, questions, notices."""
