"""What campaigns of a GNC module will know of their results, before their first hour."""
