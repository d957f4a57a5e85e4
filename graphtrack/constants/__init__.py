"""Constants of each person, learned from the recording."""
