"""From video to the table of observations."""
