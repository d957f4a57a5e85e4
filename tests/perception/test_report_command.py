"""`perception report`: the content of its folder, its messages, and resuming."""

import gc
import shutil
import tracemalloc
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from command import ran, run
from onnx_files import SIDE, brightest
from rerun_recordings import read_recording
from street_files import write_street

import graphtrack as gt
from graphtrack.errors import InputError
from graphtrack.geometry.camera import GroundCamera
from graphtrack.model import Model
from graphtrack.tracks.track import TrackSet
from perception.adaptation import learning
from perception.adaptation.learning import learn
from perception.adaptation.models import CameraModels
from perception.detection.boxes import PersonBox
from perception.drawing.overlays import DirectionEstimate
from perception.drawing.people import DrawnPerson, draw_people
from perception.images.frames import FrameSource
from perception.observation import pipeline
from perception.observation.tables import METHODS, associated, estimated, numbered
from perception.report_folder import shown_by_frame
from perception.synthetic.clips import FPS, PastedStreet, pasted_street

EVERYTHING = {
    "observations.csv",
    "tracks.csv",
    "annotated.mp4",
    "above.png",
    "report.html",
    "assumptions.txt",
    "methods.txt",
    "stages.json",
}


@pytest.fixture(scope="module")
def street() -> PastedStreet:
    return pasted_street(3, np.random.default_rng(0), offset=0.02)


@pytest.fixture(scope="module")
def arguments(street: PastedStreet, tmp_path_factory: pytest.TempPathFactory) -> list[object]:
    """Frames, boxes and a camera, as the command line names them."""
    return write_street(street, tmp_path_factory.mktemp("street"))


@pytest.fixture(scope="module")
def reported(arguments: list[object], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder of a report, and the command's output."""
    folder = tmp_path_factory.mktemp("reported") / "out"
    done = ran("report", *arguments, "-o", folder)
    return folder, done.stdout + done.stderr


@pytest.mark.slow
def test_the_folder_has_everything_and_is_read_as_its_estimates(
    reported: tuple[Path, str], street: PastedStreet
) -> None:
    folder, _ = reported
    assert {path.name for path in folder.iterdir()} == EVERYTHING
    video = FrameSource.open(folder / "annotated.mp4")
    assert video.count == 21 and video.fps == pytest.approx(FPS)
    tracks = gt.read(folder)
    assert [len(track) for track in tracks] == [7, 7, 7]
    feet = street.camera.image_to_ground(
        [(b.box[0] + b.box[2] / 2, b.box[1] + b.box[3]) for b in street.boxes]
    )
    np.testing.assert_allclose(np.concatenate([track.position for track in tracks]), feet, atol=0.6)
    assert all(
        np.isfinite(track.std("body")).any() and np.isfinite(track.std("head")).any() for track in tracks
    )


def test_it_says_what_was_assumed(reported: tuple[Path, str]) -> None:
    folder, said = reported
    assumed = (folder / "assumptions.txt").read_text().splitlines()
    page = (folder / "report.html").read_text()
    for words in ("2.5 a second (as given)", "21 boxes of", "the camera is that of", "3 walking people"):
        assert sum(words in line for line in assumed) == 1
        assert words in said and words in page
    assert page.count("data:image/jpeg;base64,") == 6


def test_what_is_done_is_not_done_again(reported: tuple[Path, str], arguments: list[object]) -> None:
    folder, _ = reported
    before = {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    done = ran("report", *arguments, "-o", folder)
    assert (done.stdout + done.stderr).count("done before") == 7
    assert {path.name: path.stat().st_mtime_ns for path in folder.iterdir()} == before


def test_what_is_done_can_be_viewed(
    reported: tuple[Path, str], arguments: list[object], street: PastedStreet, tmp_path: Path
) -> None:
    folder, _ = reported
    saved = tmp_path / "run.rrd"
    ran("report", *arguments, "-o", folder, "--view", "--save", saved)
    frames, boxes = arguments[0], arguments[2]
    again = tmp_path / "again.rrd"
    ran("view", folder, "--video", frames, "--boxes", boxes, "--save", again, program="graphtrack")
    of_street = {(one.track_id, one.frame): one.box for one in street.boxes}
    for path in (saved, again):
        found = read_recording(path)
        assert len(found["/video/frame"]["EncodedImage:blob"]) == 21
        for track in gt.read(folder):
            shown = found[f"/video/people/{track.track_id}"]
            half = [one[0] for one in shown["Boxes2D:half_sizes"].values() if one]
            known = [of_street[track.track_id, frame] for frame in track.frame.tolist()]
            np.testing.assert_allclose(2.0 * np.array(half), np.array(known)[:, 2:], rtol=1e-5)
            positions = found[f"/ground/people/{track.track_id}"]["Points2D:positions"]
            np.testing.assert_allclose([one[0] for one in positions.values()], track.position, atol=1e-5)


def breaking_off(monkeypatch: pytest.MonkeyPatch, at: int) -> list[int]:
    """The frames that are looked at from here on; a run breaks off at one of them."""
    looked: list[int] = []
    look = pipeline.observe_frame

    def breaks_off(image: np.ndarray, frame: int, *rest: object) -> object:
        looked.append(frame)
        if len(looked) == at:
            raise KeyboardInterrupt
        return look(image, frame, *rest)

    monkeypatch.setattr(pipeline, "observe_frame", breaks_off)
    return looked


@pytest.mark.slow
def test_a_run_that_breaks_off_goes_on(
    reported: tuple[Path, str], arguments: list[object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked = breaking_off(monkeypatch, 9)
    run("report", *arguments, "-o", tmp_path / "out")
    assert not (tmp_path / "out" / "observations.csv").exists()
    done = ran("report", *arguments, "-o", tmp_path / "out")
    assert "going on after 8 frames" in done.stdout + done.stderr
    assert looked == [*range(9), *range(8, 21)]
    assert {path.name for path in (tmp_path / "out").iterdir()} == EVERYTHING
    assert (tmp_path / "out" / "tracks.csv").read_bytes() == (reported[0] / "tracks.csv").read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "asks"), [pytest.param("particle", 0, marks=pytest.mark.slow), ("chain", 1)]
)
def test_what_the_camera_learned_of_the_graph_is_not_the_filters(
    method: str,
    asks: int,
    arguments: list[object],
    reported: tuple[Path, str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shutil.copytree(reported[0], tmp_path / "out")
    (tmp_path / "out" / "camera.npz").touch()
    asked = []

    class Learned:
        def graph(self, model: Model) -> Model:
            asked.append(model)
            return model

    monkeypatch.setattr(CameraModels, "load", lambda path: Learned())
    ran("report", *arguments, "-o", tmp_path / "out", "--method", method)
    assert len(asked) == asks


@pytest.mark.slow
def test_another_method_repeats_only_what_depends_on_it(
    reported: tuple[Path, str], arguments: list[object], tmp_path: Path
) -> None:
    shutil.copytree(reported[0], tmp_path / "out")
    done = ran("report", *arguments, "-o", tmp_path / "out", "--method", "particle")
    assert (done.stdout + done.stderr).count("done before") == 4
    assert "estimates by `particle`" in (tmp_path / "out" / "assumptions.txt").read_text()
    first, second = (gt.read(folder) for folder in (reported[0], tmp_path / "out"))
    assert [track.track_id for track in first] == [track.track_id for track in second]
    assert not np.array_equal(first.by_id(1).position, second.by_id(1).position)


@pytest.mark.slow
def test_without_a_camera_or_a_view_that_tells_there_is_a_scale(
    arguments: list[object], tmp_path: Path
) -> None:
    ran("report", *arguments[:3], "--fps", FPS, "-o", tmp_path / "out")
    assumed = (tmp_path / "out" / "assumptions.txt").read_text()
    assert "no camera is known" in assumed and "pixels times a scale" in assumed
    assert "no ground is known" in assumed


def test_detections_are_associated_and_keep_their_boxes(street: PastedStreet) -> None:
    boxes = [
        replace(item, track_id=k + 1, identified=False, score=1.0) for k, item in enumerate(street.boxes)
    ]
    columns = {
        "track_id": np.full(len(boxes), -1),
        "frame": np.array([item.frame for item in boxes]),
        "t": np.array([item.frame for item in boxes]) / FPS,
    }
    x, y = street.camera.image_to_ground([(b.box[0] + b.box[2] / 2, b.box[1] + b.box[3]) for b in boxes]).T
    number = np.array([item.track_id for item in boxes])
    found = associated({**columns, "x": x, "y": y}, number, boxes)
    assert found.n_frames == 21
    shown = shown_by_frame(found, found, boxes, street.camera)
    assert sorted(shown) == list(range(21))
    for item in boxes:
        (person,) = shown[item.frame]
        assert person.visible and tuple(person.box) == pytest.approx(item.box)


def test_who_is_not_seen_is_shown_where_the_estimate_is(street: PastedStreet) -> None:
    camera = street.camera
    frame, feet = np.array([0, 1, 2]), np.array([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0]])
    pixel = camera.ground_to_image(feet)
    boxes = [PersonBox(k, 4, (pixel[k, 0] - 10, pixel[k, 1] - 50 - k, 20, 50 + k)) for k in (0, 2)]
    seen = gt.Track(4, frame[[0, 2]], t=frame[[0, 2]] / FPS, position=feet[[0, 2]])
    tracks = numbered(TrackSet((seen,)), boxes)
    estimate = gt.Track(4, frame, t=frame / FPS, position=feet)
    shown = shown_by_frame(TrackSet((estimate,)), tracks, boxes, camera)
    assert [shown[k][0].visible for k in range(3)] == [True, False, True]
    np.testing.assert_allclose(shown[1][0].box, (pixel[1, 0] - 10, pixel[1, 1] - 51, 20, 51))
    np.testing.assert_allclose(shown[2][0].path, pixel)


@pytest.mark.slow
def test_what_is_shown_is_kept_as_columns() -> None:
    rows, people, camera = 2000, 3, GroundCamera.from_scale(0.02)
    frame, still = np.arange(rows), np.zeros((rows, 2))
    tracks, boxes = [], []
    for number in range(people):
        tracks.append(gt.Track(number, frame, t=frame / FPS, position=still + number))
        boxes += [PersonBox(k, number, (1.0, 2.0, 20.0, 50.0)) for k in frame.tolist()]
    seen = numbered(TrackSet(tuple(tracks)), boxes)
    gc.collect()
    tracemalloc.start()
    try:
        shown = shown_by_frame(TrackSet(tuple(tracks)), seen, boxes, camera)
        kept = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert kept < 200 * rows * people  # a made person has three times as much
    assert len(shown) == rows and rows not in shown
    assert [person.track_id for person in shown[7]] == list(range(people))


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_every_method_estimates_angles_and_their_uncertainty(method: str) -> None:
    noisy = gt.simulate("joint", n_tracks=2, rng=np.random.default_rng(0))
    short = noisy.map(lambda track: track[:6])
    done: list[int] = []
    found = estimated(short, pasted_street(1, np.random.default_rng(0)).camera, method, done.append)
    assert sum(done) == short.n_frames == found.tracks.n_frames
    assert method in found.notes[0]
    assert "Chen et al. 2011" in found.methods[0] and any("ICCV" in line for line in found.methods[1:])
    for track in found.tracks:
        assert np.isfinite(track.std("body")).all() and np.isfinite(track.std("head")).all()


def test_arrows_and_sectors_are_drawn_about_the_person_alone(street: PastedStreet) -> None:
    image = np.full((480, 640, 3), 100, np.uint8)
    camera = street.camera.resized(2.0)
    foot = camera.ground_to_image([0.0, 0.0])
    box = np.array([foot[0] - 20.0, foot[1] - 100.0, 40.0, 100.0])
    path = camera.ground_to_image([[-0.5, 0.0], [0.0, 0.0]])
    person = DrawnPerson(
        3, box, np.zeros(2), DirectionEstimate(0.5, 0.2), DirectionEstimate(1.0, 0.4), path=path
    )
    bare = draw_people(image, "", [], camera)
    drawn = draw_people(image, "", [person], camera)
    rows, columns = np.nonzero((drawn != bare).any(axis=2))
    assert rows.min() > box[1] - 30 and rows.max() < foot[1] + 80
    assert columns.min() > foot[0] - 120 and columns.max() < foot[0] + 120
    wide = draw_people(image, "", [replace(person, body=DirectionEstimate(0.5, 2.0))], camera)
    hidden = draw_people(image, "", [replace(person, visible=False)], camera)
    assert (wide != drawn).any() and (hidden != drawn).any()
    unknown = replace(person, body=None, head=None)
    assert (draw_people(image, "", [unknown], camera) != bare).any()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda a: [*a, "--calibration", a[4]], "--homography and --calibration"),
        (lambda a: [a[0], "--boxes", a[4]], "homography.txt"),
        (lambda a: [*a, "--method", "magic"], "magic"),
    ],
    ids=["two cameras", "boxes that are none", "a method that is none"],
)
def test_bad_input_is_refused_before_the_folder_is_made(
    arguments: list[object], tmp_path: Path, change: object, words: str
) -> None:
    done = run("report", *change(arguments), "-o", tmp_path / "out")
    assert done.returncode == 2
    assert words in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_folder_with_something_else_is_left_alone(arguments: list[object], tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    done = run("report", *arguments, "-o", tmp_path)
    assert done.returncode == 2 and "a folder that is not empty" in done.stderr
    (tmp_path / "notes.txt").rename(tmp_path / "stages.json")
    done = run("report", *arguments, "-o", tmp_path)
    assert done.returncode == 2 and "stages.json" in done.stderr
    assert (tmp_path / "stages.json").read_text() == "mine"


def test_a_folder_of_nothing_is_no_table(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a directory"):
        gt.read(tmp_path)


@pytest.mark.slow
def test_what_is_learned_is_learned_once(
    arguments: list[object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`observe --adapt` writes the output of `adapt` and `observe --models`, and does not learn again."""
    learned: list[int] = []

    def learn_quickly(patches: list[np.ndarray], *rest: object) -> object:
        learned.append(len(patches))
        return learn(patches, *rest)

    monkeypatch.setattr(learning, "learn", learn_quickly)
    monkeypatch.setattr(learning, "thinned", lambda labels: labels)
    monkeypatch.setattr(learning, "ROUNDS", 0)
    assert run("adapt", *arguments, "-o", tmp_path / "camera.npz").returncode == 0
    done = ran("observe", *arguments, "--models", tmp_path / "camera.npz", "-o", tmp_path / "apart.csv")
    looked = breaking_off(monkeypatch, 5)
    for _ in range(2):
        done = run("observe", *arguments, "--adapt", "-o", tmp_path / "at_once.csv")
    assert done.returncode == 0, done.stderr
    assert len(learned) == 2 and looked == [*range(5), *range(4, 21)]
    assert (tmp_path / "at_once.csv").read_bytes() == (tmp_path / "apart.csv").read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {"camera.npz", "apart.csv", "at_once.csv"}


@pytest.mark.slow
def test_one_call_takes_keypoints_and_point_pairs(tmp_path: Path) -> None:
    clip, out = tmp_path / "clip", tmp_path / "out"
    ran("simulate", "street", "-o", clip, "--frames", 8, "--people", 2, "--seed", 3)
    camera = GroundCamera.from_homography(np.loadtxt(clip / "homography.txt"))
    ground = np.array([[-2.0, 4.0], [2.0, 4.0], [2.0, 9.0], [-2.0, 9.0], [0.0, 6.0]])
    pairs = np.hstack([camera.ground_to_image(ground), ground])
    np.savetxt(tmp_path / "pairs.txt", pairs)
    given = "--keypoints", clip / "keypoints.json", "--point-pairs", tmp_path / "pairs.txt"
    ran("report", clip / "video.mp4", *given, "-o", out)
    assumed = (out / "assumptions.txt").read_text()
    assert "homography from 5 point pairs: reprojection error" in assumed and "keypoints of" in assumed
    assert "package's models" not in assumed
    # The same observations as of observe.
    ran("observe", clip / "video.mp4", *given, "-o", tmp_path / "rows.csv")
    rows, found = (
        gt.read(path, associate="always") for path in (tmp_path / "rows.csv", out / "observations.csv")
    )
    assert len(found) == len(rows) == 2
    for one, other in zip(rows, found, strict=True):
        np.testing.assert_allclose(one.body_likelihood, other.body_likelihood, atol=2e-3)
    before = (out / "tracks.csv").read_bytes()
    done = ran("report", clip / "video.mp4", *given, "-o", out)
    assert (done.stdout + done.stderr).count("done before") == 7
    # With boxes too, whose people have the keypoints; and with keypoints that are no file's any more.
    ran("report", clip / "video.mp4", *given, "--boxes", clip / "boxes.txt", "-o", tmp_path / "boxes")
    assert len(gt.read(tmp_path / "boxes")) == 2 and (out / "tracks.csv").read_bytes() == before


@pytest.mark.slow
def test_one_call_takes_a_network(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    frames, network = tmp_path / "frames", brightest(tmp_path / "detector.onnx")
    frames.mkdir()
    rng = np.random.default_rng(0)
    for k in range(12):
        shown = rng.integers(0, 40, (SIDE, SIDE, 3)).astype(np.uint8)
        shown[16:24, 8 + 4 * k : 16 + 4 * k] = 250
        cv2.imwrite(str(frames / f"{k}.png"), shown)
    ran(
        "observe",
        frames,
        "--detector",
        network,
        "--fps",
        5,
        "--write-boxes",
        tmp_path / "b.txt",
        "-o",
        tmp_path / "o.csv",
    )
    run("report", frames, "--detector", network, "--fps", 5, "-o", tmp_path / "out")
    assert (tmp_path / "out" / "boxes.txt").read_bytes() == (tmp_path / "b.txt").read_bytes()
    both = "--detector", network, "--boxes", tmp_path / "b.txt"
    done = run("report", frames, *both, "-o", tmp_path / "other")
    assert done.returncode == 2 and "--detector with --boxes" in done.stderr
