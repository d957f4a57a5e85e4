"""What people look at: figures, interactive charts, the bird's-eye replay and the one-file HTML report.

Nothing is imported here, so that ``import graphtrack`` loads neither matplotlib nor plotly.
"""
