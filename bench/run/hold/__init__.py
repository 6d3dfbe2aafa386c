"""What lets a run stand still and go on."""
