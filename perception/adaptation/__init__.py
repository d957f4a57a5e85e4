"""Models of body and head orientation fitted to one camera, with walking people as labels."""
