"""People, trackers and their cues, drawn into frames."""
