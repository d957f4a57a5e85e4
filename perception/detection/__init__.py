"""People found in frames, and boxes that others found."""
