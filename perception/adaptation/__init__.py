"""A camera teaches itself: body and head directions from people who surely walk."""
