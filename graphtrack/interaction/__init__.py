"""People in relation to each other: conversational groups and visual attention."""
