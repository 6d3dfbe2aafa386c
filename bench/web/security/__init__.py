"""Who may look and who may command: gate, login, tokens, audit."""
