"""From a recording to its files: the service that commands, page and early verdicts call."""
