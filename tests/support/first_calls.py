"""Print what the first call of each named function compiles after `graphtrack.warm_up` by its name."""

import os
import sys
from collections.abc import Callable

import numpy as np

import graphtrack as gt
from graphtrack.interaction.attention import attention
from graphtrack.interaction.people import people_at


def machine_code() -> dict[str, list[object]]:
    """The signatures of every compiled function of the package that has been called."""
    functions = [
        value
        for name, module in list(sys.modules.items())
        if name.startswith("graphtrack.")
        for value in list(vars(module).values())
        if getattr(value, "signatures", None)
    ]
    return {f"{one.py_func.__module__}.{one.py_func.__name__}": list(one.signatures) for one in functions}


def calls() -> dict[str, Callable[[], object]]:
    """Return name → a call."""
    people = gt.simulate("joint", n_tracks=3, n_steps=12, rng=np.random.default_rng(0))

    def detections() -> None:
        tracker = gt.OnlineTracker("joint", lag=0.5)
        for k in range(12):
            seen = [
                gt.Observation(
                    0.1 * k,
                    position=tuple(one.position[k]),
                    body=float(one.body[k]),
                    score=0.5,
                    inputs={"appearance": np.array([1.0, float(number)])},
                )
                for number, one in enumerate(people)
            ]
            tracker.update(0.1 * k, seen[: 3 - k % 2])
        tracker.forecast(0.8)

    def behaviour(*, gaze: bool) -> None:
        groups, targets = gt.OnlineGroups(), gt.OnlineAttention() if gaze else None
        for k in range(6):
            numbers = {
                one.track_id: (*one.position[k], 0.0, 0.0, one.body[k], one.head[k], 0.01, 0.01)
                for one in people
            }
            here = people_at(float(k), k, numbers)
            found = groups.take(here)
            if targets is not None:
                targets.take(here, found)

    def observed() -> None:
        smoother = gt.OnlineSmoother("joint")
        for t in (0.0, 0.2, 0.1):
            smoother.update(gt.Observation(t, position=(t, 0.0)))

    return {
        "smooth": lambda: gt.smooth(people, "joint"),
        "solve": lambda: gt.solve(people, "joint"),
        "OnlineSmoother": observed,
        "track_online": lambda: gt.track_online(people, "joint"),
        "OnlineTracker": detections,
        "associate": lambda: gt.associate(people),
        "groups": lambda: gt.groups(people),
        "OnlineGroups": lambda: behaviour(gaze=False),
        "attention": lambda: attention(people),
        "OnlineAttention": lambda: behaviour(gaze=True),
        "forecast": lambda: gt.forecast(people, horizon=0.8),
        "Forecaster": lambda: gt.forecast(people, horizon=0.8),
    }


def main() -> None:
    """Print what each call that the command line names compiles after `graphtrack.warm_up`."""
    named = calls()
    assert not machine_code()
    for name in sys.argv[1:]:
        sys.stdout.flush()
        if not os.fork():
            gt.warm_up("joint", functions=name)
            before = machine_code()
            named[name]()
            new = [key for key, now in machine_code().items() if now != before.get(key)]
            print(name, "compiles", ", ".join(new) or "nothing")
            sys.stdout.flush()
            os._exit(0)
        os.wait()


if __name__ == "__main__":
    main()
