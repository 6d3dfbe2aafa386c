"""The overview of many units."""
