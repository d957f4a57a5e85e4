"""The mixed-state head tracker (004)."""
