"""Data association: detections without identities become tracks."""
