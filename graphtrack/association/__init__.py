"""Who is who: detections without identities become tracks."""
