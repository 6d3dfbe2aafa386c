"""How each kind of step is carried out, and where the run stands."""
