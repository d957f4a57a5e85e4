"""Every kind of saved state with every option: a resumed run equals an uninterrupted one, bit by bit."""

import asyncio
import json
import signal
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import ran
from selection import others_slow

import graphtrack as gt
from graphtrack.errors import InputError
from graphtrack.geometry.camera import GroundCamera
from graphtrack.service import app
from graphtrack.service.settings import Metrics, Service
from graphtrack.service.stream import open_stream, prepare
from graphtrack.tracks.scene import SceneParameters

CAMERA = [[0.01, 0.0, -1.0], [0.0, 0.01, -2.0], [0.0, 0.0, 1.0]]
AREA = "POLYGON ((-3 -3, 16 -3, 16 8, -3 8, -3 -3))"
SCENE = "clutter_density = 1e-4\nbirth_density = 2e-3\nlook_ahead = 6\n"
MODEL_FILE = 'preset = "joint"\n[motion]\nacceleration_density = 0.4\n'
FRAMES, SECONDS = 90, 0.1


@dataclass(frozen=True)
class Case:
    """Options of a stream, for the commands and for Python.

    Attributes
    ----------
    model : a preset, or the text of a model file
    scene : known parameters of the scene in the model file
    """

    model: str = "position"
    engine: str = "chain"
    scene: str = ""
    camera: bool = False
    walkable: bool = False
    groups: bool = False
    attention: bool = False
    forecast: bool = False

    @property
    def model_name(self) -> str:
        """Return the value of ``--model``, for which `write_files` writes a file where it is one."""
        return "model.toml" if "=" in self.model or self.scene else self.model

    def write_files(self, folder: Path) -> None:
        """Write the files that the options name."""
        text = self.model if "=" in self.model else f'preset = "{self.model}"\n'
        (folder / "model.toml").write_text(text + (f"[scene]\n{self.scene}" if self.scene else ""))
        (folder / "plane.txt").write_text("\n".join(" ".join(map(str, row)) for row in CAMERA))
        (folder / "area.wkt").write_text(AREA)
        (folder / "places.csv").write_text("name,x,y,radius\nbar,1,3,0.5\n")

    def options(self) -> list[str]:
        """Return the options of the commands."""
        given = ["--model", self.model_name, "--engine", self.engine, "--lag", "1"]
        given += ["--homography", "plane.txt"] if self.camera else []
        given += ["--walkable", "area.wkt"] if self.walkable else []
        given += ["--groups"] if self.groups else []
        given += ["--attention", "--places", "places.csv"] if self.attention else []
        return given + (["--forecast", "2"] if self.forecast else [])

    def keywords(self) -> dict[str, Any]:
        """Return the keywords of `OnlineSmoother`."""
        found: dict[str, Any] = {"model": self.model_name, "engine": self.engine, "lag": 1.0}
        found |= {"camera": GroundCamera.from_homography(CAMERA)} if self.camera else {}
        return found | ({"walkable": "area.wkt"} if self.walkable else {})


CASES = {
    "plain": Case(),
    "model file": Case(MODEL_FILE),
    "separate": Case("separate"),
    "known scene": Case(scene=SCENE),
    "known scene in a model file": Case(MODEL_FILE, scene="clutter_density = 1e-4\n"),
    "walkable": Case(walkable=True),
    "camera": Case("joint", camera=True),
    "groups": Case("joint", groups=True),
    "attention": Case("joint", attention=True),
    "forecasts": Case(forecast=True),
    "model with groups": Case("social"),
    "everything": Case(MODEL_FILE, "chain", SCENE, True, True, True, True, True),
}
OTHER_ENGINES = {
    f"{name}, {engine}": replace(case, engine=engine)
    for engine in ("fixed-lag", "isam2")
    for name, case in CASES.items()
}
EVERY_TIME = [("everything", False), ("known scene, isam2", True)]


def rows(case: Case, *, identified: bool) -> list[dict[str, Any]]:
    """Three people who walk, one of whom leaves and returns; enough rows to learn the scene again."""
    rng, found = np.random.default_rng(5), []
    last = FRAMES if case.engine == "chain" and "=" not in case.model and case.model != "social" else 40
    for k in range(last):
        for i in range(3):
            if i == 2 and 0.4 * last < k < 0.6 * last:
                continue
            x, y = np.add((0.1 * k + 0.3 * i, 1.5 * i), rng.normal(0.0, 0.05, 2)).tolist()
            row: dict[str, Any] = {"frame": k, "t": round(SECONDS * k, 6)}
            row |= {"track_id": 7 * i} if identified else {}
            if case.camera:
                row |= {"u": round(100.0 * x + 100.0, 3), "v": round(100.0 * y + 200.0, 3)}
            else:
                row |= {"x": round(x, 4), "y": round(y, 4)}
            if case.model != "position":
                row |= {"body_deg": round(rng.normal(0.0, 20.0), 2), "head_deg": round(rng.normal(), 2)}
            found.append(row)
            if identified and i == 0 and k % 3 == 0:  # a second sensor at the same time
                found.append({**row, "pos_std": 0.2})
    return found


def parts(given: list[Any], *, within_a_frame: bool = False) -> tuple[list[Any], list[Any]]:
    """Split rows between two frames, or after the second row of a frame."""
    middle = next(k for k in range(len(given) // 3, len(given)) if given[k - 1]["frame"] < given[k]["frame"])
    middle += 2 * within_a_frame
    return given[:middle], given[middle:]


both_kinds = pytest.mark.parametrize("identified", [True, False], ids=["identities", "detections"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "identified"),
    others_slow([(name, kind) for name in (*CASES, *OTHER_ENGINES) for kind in (True, False)], EVERY_TIME),
)
def test_the_command(name: str, identified: bool, cwd: Path) -> None:
    case = {**CASES, **OTHER_ENGINES}[name]
    case.write_files(cwd)
    given = rows(case, identified=identified)
    whole = ran("track", "-", *case.options(), program="graphtrack", rows=given).stdout
    found = ""
    for part in parts(given):
        options = [*case.options(), "--state", "kept.state"]
        found += ran("track", "-", *options, program="graphtrack", rows=part).stdout
    assert found == whole and len(whole.splitlines()) > 80


@pytest.mark.slow
@both_kinds
@pytest.mark.parametrize("name", others_slow(CASES, ["everything"]))
def test_the_service(name: str, identified: bool, cwd: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    case = CASES[name]
    case.write_files(cwd)
    services: list[Service] = []
    monkeypatch.setattr(app, "run", lambda service, *_: services.append(service))
    for options in ((), ("--state", "streams")):
        ran("serve", *case.options(), *options, program="graphtrack")
    prepare(services[0])
    given = rows(case, identified=identified)
    whole = asyncio.run(served(services[0], given))
    first, second = parts(given, within_a_frame=True)
    found = asyncio.run(served(services[1], first, killed=True))
    resumed, *more = asyncio.run(served(services[1], second))
    assert json.loads(resumed) == {"rows": len(first), "line": len(first), "given_again": 1}
    kept = found[:-1] if identified else found  # a detection is answered when its frame has ended
    assert [*kept, *more] == whole and len(whole) > 80


async def served(service: Service, given: list[dict[str, Any]], *, killed: bool = False) -> list[str]:
    """Return the answers of a stream of a service, of which the process is killed once all are there."""
    stream, found = await open_stream("one", service, Metrics()), list[str]()

    async def receive() -> None:
        async for lines in stream.answers():
            found.extend(lines)

    receiving = asyncio.create_task(receive())
    for some in (given[:-1], given[-1:]):  # the last row is saved by itself
        await stream.take([json.dumps(row).encode() for row in some])
        while killed and stream._waiting:
            await asyncio.sleep(0.01)
    if killed:
        stream._process.kill()
    stream.no_more()
    await receiving
    assert await stream.end() == (-signal.SIGKILL if killed else 0)
    return found


def numbers(value: Any) -> Any:
    """Return a result as values that compare bit by bit."""
    return repr([asdict(one) for one in value] if isinstance(value, list) else asdict(value))


def through_json(state: dict[str, Any]) -> dict[str, Any]:
    return json.loads(json.dumps(state, allow_nan=False))  # type: ignore[no-any-return]


def observations(given: list[dict[str, Any]]) -> list[gt.Observation]:
    found = []
    for row in given:
        place = {"pixel": (row["u"], row["v"])} if "u" in row else {"position": (row["x"], row["y"])}
        angles = {name: np.radians(row[f"{name}_deg"]) for name in ("body", "head") if f"{name}_deg" in row}
        std = row.get("pos_std")
        found.append(gt.Observation(row["t"], row["frame"], position_std=std, **place, **angles))
    return found


@pytest.mark.parametrize(
    "name",
    others_slow([name for name in CASES if name not in ("groups", "attention")], ["everything"]),
)
def test_a_tracker(name: str, cwd: Path) -> None:
    case = CASES[name]
    case.write_files(cwd)
    given = observations(rows(case, identified=False))
    frames = [[one for one in given if one.frame == k] for k in range(given[-1].frame + 1)]
    assert_tracker_continues(case.keywords(), frames, case.forecast)


@pytest.mark.slow
@pytest.mark.parametrize(
    "scene",
    [
        pytest.param({"clutter_density": 1e-4, "look_ahead": 6}, id="some", marks=pytest.mark.slow),
        pytest.param(SceneParameters(death_rate=0.1), id="all", marks=pytest.mark.slow),
        pytest.param(None, id="none"),
    ],
)
def test_a_tracker_of_a_scene(scene: Any) -> None:
    given = observations(rows(Case(), identified=False))
    frames = [[one for one in given if one.frame == k] for k in range(FRAMES)]
    assert_tracker_continues({"model": "position", "lag": 1.0, "scene": scene}, frames, False)


def assert_tracker_continues(
    keywords: dict[str, Any], frames: list[list[gt.Observation]], forecast: bool
) -> None:
    whole, resumed = gt.OnlineTracker(**keywords), gt.OnlineTracker(**keywords)
    for k, seen in enumerate(frames):
        expected, found = (one.update(SECONDS * k, seen) for one in (whole, resumed))
        assert numbers(found) == numbers(expected) and resumed.revised == whole.revised
        if forecast:
            assert numbers(resumed.forecast()) == numbers(whole.forecast())
        if k % 11 == 3:
            resumed = gt.OnlineTracker.from_state(through_json(resumed.state()), **keywords)
            assert resumed.scene == whole.scene


WITHOUT_ANSWERS = [
    name for name, case in CASES.items() if not (case.groups or case.attention or case.forecast)
]


@pytest.mark.parametrize(
    ("name", "engine"),
    others_slow(
        [(name, engine) for name in WITHOUT_ANSWERS for engine in ("chain", "fixed-lag")],
        [("separate", "fixed-lag"), ("camera", "chain")],
    ),
)
def test_a_smoother(name: str, engine: Any, cwd: Path) -> None:
    case = replace(CASES[name], engine=engine)
    case.write_files(cwd)
    keywords = case.keywords()
    whole, resumed = gt.OnlineSmoother(**keywords), gt.OnlineSmoother(**keywords)
    for k, one in enumerate(observations(rows(case, identified=True))[::3]):
        assert numbers(resumed.update(one)) == numbers(whole.update(one))
        if k % 11 == 3:
            resumed = gt.OnlineSmoother.from_state(through_json(resumed.state()), **keywords)


@pytest.mark.parametrize("other", [{}, {"scene": {"clutter_density": 1e-3}}, {"lag": 2.0}])
def test_a_tracker_of_another_scene_or_lag_is_refused_by_name(other: dict[str, Any]) -> None:
    keywords: dict[str, Any] = {"scene": {"clutter_density": 1e-4}, "lag": 1.0}
    tracker = gt.OnlineTracker("position", **keywords)
    tracker.update(0.0, [(0.0, 0.0)])
    named = next(iter(other), "scene").replace("scene", "clutter_density")
    with pytest.raises(InputError, match=f"a state with {named} = .*, expected one with {named} = "):
        changed = keywords | other if other else {"lag": 1.0}
        gt.OnlineTracker.from_state(through_json(tracker.state()), "position", **changed)
