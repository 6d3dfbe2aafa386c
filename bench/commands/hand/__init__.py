"""``bench talk``, ``commission`` and ``drill``: an instrument by hand, the first contact, the guard."""
