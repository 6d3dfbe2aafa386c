"""Finished sessions on the page: listing, history, replay."""
