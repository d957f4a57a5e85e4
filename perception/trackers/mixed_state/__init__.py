"""The mixed-state head tracker (Ba & Odobez 2003)."""
