"""The feed of a run: what it does, for whoever looks at it, from a memory of fixed size (docs/live-protocol.md)."""

from bench.run.feed.client import FeedClient, FeedGone, FeedReply
from bench.run.feed.planned import steps_of
from bench.run.feed.state import RunState

__all__ = ["FeedClient", "FeedGone", "FeedReply", "RunState", "steps_of"]
