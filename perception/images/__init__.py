"""Pictures and videos, read, checked and written."""
