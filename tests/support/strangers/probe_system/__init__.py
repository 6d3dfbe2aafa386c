"""A system of somebody else: resistances in a chamber, read by a scanner and a meter."""
