"""``bench init`` and ``bench list``: a laboratory's own folder."""
