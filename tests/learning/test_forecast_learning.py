"""Learning of forecasts: training data, and recovery of known parameters."""

from dataclasses import replace

import numpy as np
import pytest

import graphtrack as gt
from graphtrack.errors import InputError
from graphtrack.forecasting.forecaster import Forecaster, mean_turn, turn_to_head
from graphtrack.forecasting.motion import ForecastParameters
from graphtrack.learning import forecasts as learning
from graphtrack.learning.forecasts import forecasts, recording

STEP = 0.4


def crowd(count=15, seed=1, steps=30):
    """People who meet, turn and come at different times."""
    rng = np.random.default_rng(seed)
    people = []
    for k in range(count):
        speeds = rng.normal(0, 0.8, 2) + np.cumsum(rng.normal(0, 0.1, (steps, 2)), axis=0)
        where = rng.uniform(-4, 4, 2) + np.cumsum(STEP * speeds, axis=0)
        frame = int(rng.integers(0, 30)) + np.arange(steps)
        people.append(gt.Track(k, frame, STEP * frame, where))
    return gt.TrackSet(tuple(people))


def test_what_came_of_people_is_where_they_were_and_unknown_when_they_had_left():
    scene = crowd(count=1)
    position = scene[0].position[:, 0] + 1j * scene[0].position[:, 1]
    for k, (_, people, actual, straight) in enumerate(forecasts(recording(scene), ForecastParameters())):
        now = k + 1  # the first forecast is made in the second frame
        assert people.tolist() == [0]
        later = position[now + 1 : now + 13]
        np.testing.assert_allclose(actual[0, : len(later)], later)
        assert np.isnan(actual[0, len(later) :]).all()
        going = position[now] + 3 * (position[now] - position[now - 1])
        assert straight[0, 2] == pytest.approx(going)


def test_the_search_finds_the_least_of_a_valley_and_stays_there():
    def cost(one):
        return abs(one.stop_speed - 0.3) + abs(np.log(one.place_prior / 3.0)) + one.companion_weight

    found = learning._search(learning.START, learning.PLACE_STEPS, cost, lambda what: None)
    assert (found.stop_speed, found.place_prior, found.companion_weight) == (0.3, 3.0, 0.0)


def test_how_far_the_head_leads_is_found():
    rng, truth = np.random.default_rng(2), replace(ForecastParameters(), head_share=0.6, head_limit=1.2)
    angle, velocity = rng.uniform(-2, 2, 500), rng.normal(0, 1, 500) + 1j * rng.normal(0, 1, 500)
    turned = turn_to_head(angle, np.ones(500), truth)[:, None] * mean_turn(learning._HEAD_TIMES, truth)
    moved = velocity[:, None] * learning._HEAD_TIMES * np.exp(1j * turned)
    heads = learning.Heads(velocity, angle, np.ones(500), moved)
    found = learning._search(learning.START, learning.HEAD_STEPS, heads.error, lambda what: None)
    assert heads.error(found) <= heads.error(replace(truth, head_share=0.0)) / 10
    assert found.head_share == pytest.approx(0.6, abs=0.11)


def test_circles_err_least_where_their_spread_is_that_of_the_people():
    scene = recording(crowd(count=25))
    fitted = learning._fit_spread([learning.outcomes(scene, ForecastParameters())], ForecastParameters())
    losses = [
        learning.calibration_error(
            scene,
            replace(
                fitted,
                scene_prior=1e6,
                spread_standing=fitted.spread_standing * factor,
                spread_walking=fitted.spread_walking * factor,
            ),
        )
        for factor in (0.3, 1.0, 3.0)
    ]
    assert losses[1] == min(losses)


def test_a_forecaster_goes_on_where_its_state_was_taken():
    scene, whole, broken = recording(crowd()), Forecaster(), Forecaster()
    for seen in scene.frames:
        for one in (whole, broken):
            one.update(seen.t, seen.track_id, seen.position, seen.std, seen.head)
        told = [one.forecast([0.4, 2.0, 6.0]) for one in (whole, broken)]
        for name in ("track_id", "position", "covariance", "radius_50", "radius_90"):
            np.testing.assert_array_equal(getattr(told[0], name), getattr(told[1], name))
        broken = Forecaster.from_state(broken.state())


def test_recordings_that_nothing_can_be_learned_from_are_told():
    with pytest.raises(InputError, match="at least one"):
        learning.fit_forecast({})
    with pytest.raises(InputError, match="no person observed"):
        learning.fit_forecast({"short": crowd(count=3, steps=2)})
