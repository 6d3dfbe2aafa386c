"""A mapping proposed for a log that nobody has described yet."""

from bench.commands.importing.guess import guess
