"""Rights to look and to command: gate, login, tokens, audit."""
