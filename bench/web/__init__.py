"""The live page: a process of its own that shows runs and sessions, and passes commands on to a run."""
