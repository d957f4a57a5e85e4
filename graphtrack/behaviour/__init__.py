"""What people do together: who stands or walks with whom, and who looks at what."""
