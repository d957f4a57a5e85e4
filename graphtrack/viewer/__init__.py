"""The view of tracks in Rerun: the ground, the video and the series of one person on one time line.

Nothing is imported here, and Rerun only when something is shown.
"""
