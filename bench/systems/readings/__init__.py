"""Values that a sequence reads, of any unit: no system of its own, so that a check needs no programming."""
