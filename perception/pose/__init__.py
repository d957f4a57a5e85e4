"""Directions of bodies and heads in pictures of people."""
