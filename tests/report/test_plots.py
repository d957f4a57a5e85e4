"""Figures: what is drawn of tracks, angles and errors, their shapes, and legibility."""

import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up import ERRORS, observed, walker
from matplotlib.colors import to_rgba
from matplotlib.patches import Ellipse
from matplotlib.quiver import Quiver

from graphtrack.errors import InputError
from graphtrack.geometry.angles import difference, wrap
from graphtrack.interaction.attention import Attention, attention
from graphtrack.interaction.groups import groups
from graphtrack.report.plots import plot_angles, plot_errors, plot_reliability, plot_tracks
from graphtrack.report.plots.interaction import plot_group_timeline, plot_look_timeline
from graphtrack.report.plots.scene import CROWD
from graphtrack.report.style import angle_bands, break_at_seam
from graphtrack.tracks.display import BODY_COLOUR, HEAD_COLOUR, PERSON_COLOURS
from graphtrack.tracks.track import Track, TrackSet


def arrows(axes, colour):
    from matplotlib.colors import to_rgba

    found = [c for c in axes.collections if isinstance(c, Quiver)]
    return [q for q in found if np.allclose(q.get_facecolor()[0], to_rgba(colour))]


def is_dotted(line):
    # Dots are dashes without a length, and round.
    return line.get_linestyle() == "--" and line.get_dash_capstyle() == "round"


def labels(figure):
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def test_the_drawn_ellipses_hold_95_percent_of_the_position():
    covariance = np.zeros((40, 6, 6))
    covariance[:, :2, :2] = [[0.3, 0.12], [0.12, 0.1]]
    track = walker(n=40, covariance=covariance)
    figure = plot_tracks(TrackSet((track,)), arrow_interval=0.4)
    patches = [p for p in figure.axes[0].patches if isinstance(p, Ellipse)]
    assert len(patches) == 4  # 1.6 s
    rng = np.random.default_rng(0)
    for patch, i in zip(patches, (0, 10, 20, 30), strict=True):
        samples = rng.multivariate_normal(track.position[i], covariance[i, :2, :2], 5000)
        outline = patch.get_patch_transform().transform_path(patch.get_path())
        assert np.mean(outline.contains_points(samples)) == pytest.approx(0.95, abs=0.015)


def test_arrows_point_where_the_angles_do_and_have_their_colours():
    track = walker(n=50)
    axes = plot_tracks(TrackSet((track,)), arrow_interval=0.2).axes[0]
    for name, colour in (("body", BODY_COLOUR), ("head", HEAD_COLOUR)):
        (quiver,) = arrows(axes, colour)
        assert np.arctan2(quiver.V, quiver.U) == pytest.approx(getattr(track, name)[::5])
        # Next to the position, each to its own side, so that the path is not hidden.
        aside = quiver.get_offsets() - track.position[::5]
        left = np.stack([-quiver.V, quiver.U], axis=1)
        along = np.stack([quiver.U, quiver.V], axis=1)
        assert np.sum(aside * along, axis=1) == pytest.approx(0.0, abs=1e-9)
        assert np.all(np.sum(aside * left, axis=1) * (1.0 if name == "body" else -1.0) > 0.01)


def test_no_arrow_stands_where_nothing_was_observed():
    estimate = walker()
    figure = plot_tracks(
        TrackSet((estimate,)), TrackSet((observed(estimate, slice(20, 35)),)), arrow_interval=0.1
    )
    (quiver,) = arrows(figure.axes[0], BODY_COLOUR)
    distance = np.linalg.norm(quiver.get_offsets()[:, None] - estimate.position[None], axis=2)
    assert not set(distance.argmin(axis=1)) & set(range(22, 33))


def test_ellipses_too_small_to_be_seen_are_enlarged_by_the_factor_of_the_legend():
    covariance = np.tile(1e-4 * np.eye(6), (40, 1, 1))
    figure = plot_tracks(TrackSet((walker(n=40, covariance=covariance),)))
    figure.canvas.draw()
    ellipses = [p for p in figure.axes[0].patches if isinstance(p, Ellipse)]
    (words,) = [text for text in labels(figure) if text.startswith("95 %")]
    factor = float(re.fullmatch(r"95 % of position, enlarged (\d+)×", words)[1])
    assert ellipses[0].width == pytest.approx(2.0 * factor * 0.01 * np.sqrt(5.991), rel=1e-3)
    pixels = ellipses[0].get_window_extent().width
    assert pixels > 0.1 * figure.dpi


def test_the_path_is_dotted_exactly_where_nothing_was_observed():
    estimate = walker()
    figure = plot_tracks(TrackSet((estimate,)), TrackSet((observed(estimate, slice(20, 35)),)))
    lines = figure.axes[0].lines
    (dotted,) = [line for line in lines if is_dotted(line)]
    assert dotted.get_xydata() == pytest.approx(estimate.position[19:36])
    hollow = [line for line in lines if line.get_markerfacecolor() == "white"]
    assert hollow[0].get_xydata() == pytest.approx(estimate.position[[20, 34]])
    assert "not observed" in labels(figure)


def test_a_hole_in_the_frames_is_dotted_too():
    t = np.array([0.0, 0.1, 0.2, 9.0, 9.1])
    track = Track(1, np.arange(5), t, np.stack([t, t], axis=1))
    dotted = [line for line in plot_tracks(TrackSet((track,))).axes[0].lines if is_dotted(line)]
    assert [line.get_xdata().tolist() for line in dotted] == [[0.2, 9.0]]


nan = np.nan
BARE = Track(5, [0, 1, 2], [0.0, 0.1, 0.2], [[0, 0], [nan, nan], [1, 1]])


@pytest.mark.slow
@pytest.mark.parametrize(
    "tracks",
    [
        (),
        (BARE,),
        (walker(n=1),),
        (walker(head=None, covariance=None, velocity=None),),
        (walker(body=np.full(60, nan)),),
        (walker(covariance=np.full((60, 6, 6), nan)),),
        (replace(BARE, position=np.full((3, 2), nan)),),
        (walker(label="$x_{ <b>"), walker(2, n=3)),
    ],
    ids=["nobody", "bare", "one frame", "no head", "body NaN", "covariance NaN", "no position", "odd label"],
)
def test_every_figure_can_be_drawn_of_odd_tracks(tracks, tmp_path):
    plot_tracks(TrackSet(tracks)).savefig(tmp_path / "a.png")
    for track in tracks:
        plot_angles(track).savefig(tmp_path / "b.png")
        plot_angles(track, BARE).savefig(tmp_path / "c.png")


def test_no_line_of_an_angle_crosses_the_seam():
    estimate = walker(n=200)
    figure = plot_angles(estimate, observed(estimate))
    assert len(figure.axes) == 2
    for axes in figure.axes:
        drawn = [line for line in axes.lines if line.get_linestyle() in ("-", "--")]
        assert len(drawn) >= 2  # the estimate and the truth
        for line in drawn:
            steps = np.abs(np.diff(np.asarray(line.get_ydata(), dtype=float)))
            assert np.all(steps[np.isfinite(steps)] <= 180.0)
        for band in axes.collections:
            assert np.abs(band.get_paths()[0].vertices[:, 1]).max() <= 180.0 + 1e-9


def test_bands_have_the_width_of_the_covariance():
    std = 0.1
    covariance = np.tile(np.eye(6) * std**2, (20, 1, 1))
    track = walker(n=20, body=np.zeros(20), head=None, covariance=covariance)
    (axes,) = plot_angles(track).axes
    widths = {band.get_label(): np.ptp(band.get_paths()[0].vertices[:, 1]) for band in axes.collections}
    assert widths["±1σ"] == pytest.approx(np.degrees(2 * std))
    assert widths["95 %"] == pytest.approx(np.degrees(2 * 1.96 * std), rel=1e-3)


def test_an_angle_that_nobody_knows_has_no_panel():
    figure = plot_angles(walker(head=None))
    assert [axes.get_ylabel() for axes in figure.axes] == ["body (°)"]
    assert "no angle" in plot_angles(BARE).axes[0].texts[0].get_text()


def test_class_likelihoods_are_drawn_at_the_centre_of_the_likeliest_class():
    likelihood = np.full((3, 8), 0.01)
    likelihood[[0, 1, 2], [0, 3, 6]] = 1.0
    observation = replace(BARE, body_likelihood=likelihood)
    (axes,) = plot_angles(walker(5, n=3, head=None), observation).axes
    (dots,) = [line for line in axes.lines if line.get_label() == "observation"]
    assert np.radians(dots.get_ydata()) == pytest.approx(wrap(np.pi / 4 * np.array([0, 3, 6])))


@pytest.mark.parametrize("table", [ERRORS, pd.DataFrame(ERRORS)], ids=["dicts", "frame"])
def test_errors_stand_at_their_median_with_their_spread(table):
    figure = plot_errors(table)
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["position error (m)", "head error (°)"]
    dots = [line for line in figure.axes[0].lines if line.get_marker() == "o"]
    assert [line.get_xydata()[0].tolist() for line in dots] == [[0.2, 0], [0.1, 1]]
    spreads = [line.get_xdata().tolist() for line in figure.axes[0].lines if line.get_marker() != "o"]
    assert spreads == [[0.1, 0.4], [0.05, 0.2]]
    assert len([line for line in figure.axes[1].lines if line.get_marker() == "o"]) == 1  # NaN is left out


def test_tables_that_lack_something_are_refused():
    with pytest.raises(InputError, match="at least one row"):
        plot_errors([])
    with pytest.raises(InputError, match="row 1 without unit"):
        plot_errors([ERRORS[0], {k: v for k, v in ERRORS[1].items() if k != "unit"}])
    with pytest.raises(InputError, match="a number"):
        plot_errors([{**ERRORS[0], "median": "much"}])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("code", "module"),
    [
        ("import graphtrack.report", "matplotlib"),
        ("from graphtrack.report import plots", "matplotlib.pyplot"),
    ],
)
def test_what_pictures_need_is_loaded_late(code, module):
    code += f"; import sys; assert {module!r} not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def walkers_along(count, step):
    """Each on a line of their own, five samples a second apart."""
    t = np.arange(5.0)
    walks = [np.stack([step * t, np.full(5, float(i))], axis=1) for i in range(count)]
    return TrackSet(tuple(Track(i, np.arange(5), t, walk, body=np.zeros(5)) for i, walk in enumerate(walks)))


def test_people_are_told_apart_by_colour_and_dashes():
    lines = plot_tracks(walkers_along(CROWD, 1.0)).axes[0].lines
    paths = [line for line in lines if len(line.get_xdata()) > 1 and np.isfinite(line.get_xdata()).all()]
    looks = {(line.get_color(), str(line._unscaled_dash_pattern)) for line in paths[:48]}
    assert len(paths) == CROWD and len(looks) == min(CROWD, 48)


def test_of_a_crowd_paths_are_drawn_with_names_where_there_is_room():
    few, crowd = plot_tracks(walkers_along(CROWD, 1.0)), plot_tracks(walkers_along(CROWD + 1, 1.0))
    assert len(few.axes[0].texts) == CROWD and few.axes[0].collections
    assert len(crowd.axes[0].lines) == CROWD + 1
    assert not crowd.axes[0].collections
    named = {text.get_text() for text in crowd.axes[0].texts}
    assert 0 < len(named) <= CROWD + 1
    dense = plot_tracks(walkers_along(CROWD + 1, 100.0))
    assert len(dense.axes[0].texts) < CROWD


angle_lists = st.lists(st.one_of(st.floats(-3.14, 3.14), st.just(float("nan"))), min_size=1, max_size=30)


@given(angle_lists)
def test_a_broken_curve_has_no_segment_longer_than_half_a_turn_and_keeps_its_samples(angles):
    angle = np.array(angles)
    t = np.arange(len(angle), dtype=float)
    cut_t, cut = break_at_seam(t, angle)
    steps = np.abs(np.diff(cut))
    assert np.all(steps[np.isfinite(steps)] <= np.pi + 1e-9)
    assert np.all(np.diff(cut_t) >= 0.0)
    kept = np.isin(cut_t, t) & (np.abs(cut) < np.pi)
    assert set(angle[np.isfinite(angle)]) <= set(cut[kept])


def test_a_curve_meets_the_edge_where_the_straight_path_does():
    t, angle = break_at_seam(np.array([0.0, 1.0]), np.array([np.pi - 0.1, -np.pi + 0.3]))
    assert t == pytest.approx([0.0, 0.25, 0.25, 0.25, 1.0])
    assert angle[[1, 3]] == pytest.approx([np.pi, -np.pi])
    assert np.isnan(angle[2])


@given(st.floats(-9.0, 9.0), st.floats(-3.0, 3.0), st.floats(0.01, 5.0))
def test_a_band_covers_what_is_within_its_half_width_and_nothing_else(start, rate, half):
    t = np.linspace(0.0, 3.0, 61)
    bands = angle_bands(t, wrap(start + rate * t), np.full(len(t), half))
    assert all(np.abs([band.lower, band.upper]).max() <= np.pi for band in bands)
    rng = np.random.default_rng(0)
    for _ in range(20):
        # At sample times, a little off the edges, where rounding decides.
        i, offset = rng.integers(len(t)), rng.uniform(-np.pi, np.pi)
        if abs(abs(offset) - min(half, np.pi)) < 0.01:
            continue
        angle = float(wrap(start + rate * t[i] + offset))
        covered = any(
            np.any(
                np.isclose(band.t, t[i])
                & (band.lower <= angle)
                & (angle <= band.upper)
                & (band.upper > band.lower)
            )
            for band in bands
        )
        assert covered == (abs(difference(angle, start + rate * t[i])) <= half)


def pair(seconds: float = 20.0) -> TrackSet:
    frame = np.arange(int(2 * seconds), dtype=np.int64)

    def still(one: int, x: float, head: float) -> Track:
        place = np.tile([x, 0.0], (len(frame), 1))
        return Track(
            one, frame, 0.5 * frame, place, head=np.full(len(frame), head), body=np.full(len(frame), head)
        )

    return TrackSet((still(1, 0.0, 0.0), still(2, 1.0, np.pi)))


def looking(tracks: TrackSet, share: float) -> list[Attention]:
    """Each person looks at the other with this probability, else at nothing."""
    made = []
    for one in attention(tracks):
        probability = np.zeros_like(one.probability)
        probability[:, 0], probability[:, -1] = share, 1.0 - share
        made.append(replace(one, probability=probability))
    return made


def legends_inside(figure) -> list[bool]:
    figure.canvas.draw()
    return [
        axes.get_window_extent().overlaps(axes.get_legend().get_window_extent())
        for axes in figure.axes
        if axes.get_legend() is not None
    ]


@pytest.mark.parametrize("methods", [1, 2, 6])
def test_the_legend_of_reliability_covers_no_curve(methods: int) -> None:
    shares = np.linspace(0.05, 0.95, 19)
    rows = [
        {"method": f"method {k}", "quantity": q, "nees": 1.0, "confidence": shares, "coverage": shares**0.1}
        for k in range(methods)
        for q in ("position", "velocity", "body")
    ]
    inside = legends_inside(plot_reliability(rows))
    assert len(inside) == 3 and not any(inside)


def test_the_timeline_of_looks_spans_the_recording() -> None:
    tracks = pair()
    found = looking(tracks, 0.9)
    for one in found:
        # Both look at each other for a moment in the middle only.
        late = np.abs(np.arange(len(one.t)) - 20) > 2
        one.probability[late] = 0.0
        one.probability[late, -1] = 1.0
    low, high = plot_look_timeline(found, tracks.names).axes[0].get_xlim()
    assert low <= 0.0 and high >= tracks.by_id(1).t[-1] and high - low < 1.1 * tracks.by_id(1).t[-1] + 1.0


def test_the_timeline_of_groups_spans_the_recording() -> None:
    found = groups(pair())
    low, high = plot_group_timeline(found, (), {}).axes[0].get_xlim()
    assert (low, high) == (found.t.min(), found.t.max())


# Linear red, green and blue as seen without one kind of cones: Machado, Oliveira and Fernandes (2009).
PROTANOPE = ((0.152, 1.053, -0.205), (0.115, 0.786, 0.099), (-0.004, -0.048, 1.052))
DEUTERANOPE = ((0.367, 0.861, -0.228), (0.280, 0.673, 0.047), (-0.012, 0.043, 0.969))
TRITANOPE = ((1.256, -0.077, -0.179), (-0.078, 0.931, 0.148), (0.005, 0.691, 0.304))
TO_XYZ = np.array([[0.4339, 0.3762, 0.1899], [0.2127, 0.7152, 0.0722], [0.0178, 0.1095, 0.8730]])


def lightness_and_hue(linear):
    """CIELAB coordinates (n, 3) of linear sRGB."""
    root = np.cbrt(np.clip(linear, 0.0, 1.0) @ TO_XYZ.T)
    return np.column_stack(
        [116.0 * root[:, 1] - 16.0, 500.0 * (root[:, 0] - root[:, 1]), 200.0 * (root[:, 1] - root[:, 2])]
    )


@pytest.mark.parametrize("seen", [np.eye(3), PROTANOPE, DEUTERANOPE, TRITANOPE])
def test_colours_of_people_are_far_apart_on_light_and_dark_ground(seen):
    assert len(set(PERSON_COLOURS)) == len(PERSON_COLOURS) >= 10
    value = np.array([to_rgba(one)[:3] for one in (*PERSON_COLOURS, BODY_COLOUR, HEAD_COLOUR)])
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    shown = lightness_and_hue(linear @ np.transpose(seen))
    apart = np.linalg.norm(shown[:, None] - shown, axis=2)[np.triu_indices(len(shown), 1)]
    assert apart.min() > (20.0 if np.array_equal(seen, np.eye(3)) else 14.0)
    luminance = linear[: len(PERSON_COLOURS)] @ TO_XYZ[1]
    assert (1.05 / (luminance + 0.05) >= 1.9).all()  # contrast with white, and with the page in dark mode
    assert ((luminance + 0.05) / (0.008 + 0.05) >= 1.9).all()
