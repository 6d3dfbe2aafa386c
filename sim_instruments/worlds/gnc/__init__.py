"""GNC modules on their board and table."""
