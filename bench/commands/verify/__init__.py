"""``bench report --verify``."""
