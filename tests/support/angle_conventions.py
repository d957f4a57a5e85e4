"""Every convention of angles, for Hypothesis."""

from hypothesis import strategies as st

from graphtrack.geometry.conventions import COMPASS, IMAGE, AngleConvention

_ZEROS = st.sampled_from([*IMAGE, *COMPASS, "x", "y", "-x", "-y"]) | st.integers(-180, 360)
CONVENTIONS = st.builds(
    AngleConvention, _ZEROS, st.sampled_from(["ccw", "cw"]), st.sampled_from(["deg", "rad"])
)
