"""The published systems, one package each; they do not know each other."""
