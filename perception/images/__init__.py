"""Pictures and videos: read, checked, drawn on."""
