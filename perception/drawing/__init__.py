"""Drawing of people, trackers and their cues into frames."""
