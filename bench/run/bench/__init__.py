"""What opens the bench, makes it safe and drills that."""
