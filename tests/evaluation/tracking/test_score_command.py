"""`graphtrack score`: pairs of files to tables and JSON, and one-line errors."""

import json

import numpy as np
import pandas as pd
import pytest
from command import run as run_program

import graphtrack as gt
from graphtrack.errors import InputError, InputWarning

HEADER = "track_id,frame,t,x,y\n"


def table(ids=(1, 2), frames=range(20), off=0.0):
    """People who walk side by side, 5 m apart."""
    return HEADER + "".join(f"{i},{k},{k / 10},{k / 10},{5 * i + off}\n" for i in ids for k in frames)


def mot(ids=(1, 2), confidence=1, left=0):
    """The same as boxes of an image, without positions."""
    return "".join(
        f"{k},{i},{10 * k + left},{200 * i},40,100,{confidence},-1,-1,-1\n" for i in ids for k in range(20)
    )


@pytest.fixture
def here(cwd):
    files = {
        "truth.csv": table(),
        "one.csv": table(ids=(1,)),
        "later.csv": table(frames=range(100, 120)),
        "truth.txt": mot(),
        "boxes.txt": mot(ids=(1,), left=10) + mot(ids=(2,), confidence=0),
        "detections.txt": mot(ids=(-1,)),
        "twice.txt": mot() + mot(ids=(2,)),
        "nowhere.txt": "1,1,-1,-1,-1,-1,1,2,3,0\n2,1,-1,-1,-1,-1,1,2,3,0\n",
        "estimates/a.csv": table(ids=(1,)),
        "estimates/b.csv": table(off=0.3),
        "true/a.csv": table(),
        "true/b.csv": table(),
        "other/c.csv": table(),
        "other/a.csv": table(),
    }
    for name, text in files.items():
        (cwd / name).parent.mkdir(exist_ok=True)
        (cwd / name).write_text(text)
    (cwd / "empty").mkdir()
    return cwd


def run(*arguments):
    return run_program("score", *arguments, program="graphtrack")


@pytest.mark.parametrize("offset", [1, -1])
@pytest.mark.parametrize("times", [True, False])
def test_frames_that_begin_at_another_number(here, offset, times):
    """With the offset that the note names all scores are those of frames that are numbered alike."""
    rng = np.random.default_rng(3)
    frame, ids = np.tile(np.arange(4, 30), 3), np.repeat([1, 2, 3], 26)
    x = 1.5 * np.sin(frame / 4) + rng.normal(0, 0.01, len(frame))
    rows = pd.DataFrame({"track_id": ids, "frame": frame, "t": frame / 10, "x": x, "y": 5.0 * ids})
    moved = rows.assign(frame=rows.frame - offset, t=rows.t - offset / 10)
    for name, of in (("walk.csv", rows), ("moved.csv", moved)):
        (of if times else of.drop(columns="t")).to_csv(name, index=False)
    options = ["--truth", "walk.csv", "--metres", "0.05", *([] if times else ["--fps", "10"])]
    first = run("moved.csv", *options)
    assert first.returncode == 0 and f"--frame-offset {offset} " in first.stderr, first.stderr
    done = run("moved.csv", *options, "--frame-offset", offset, "--json", "score.json")
    assert done.returncode == 0 and "begin at" not in done.stderr, done.stderr
    found = json.loads((here / "score.json").read_text())
    assert found["together"]["hota"] == 1.0
    position = next(row for row in found["states"]["rows"] if row["quantity"] == "position")
    assert position["frames"] == len(rows) and position["rmse"] < 1e-9
    read = [gt.read(name, fps=None if times else 10) for name in ("moved.csv", "walk.csv")]
    errors = gt.score_states(*read, metres=0.05, frame_offset=offset).rows[0]
    assert errors["rmse"] == position["rmse"]


def test_an_offset_of_numbers_moves_no_times_that_agree(here):
    """Frames with other numbers at the same times are compared by time, with or without an offset."""
    rows = pd.read_csv("truth.csv")
    rows.assign(frame=rows.frame + 1).to_csv("one.csv", index=False)
    with pytest.warns(InputWarning, match="compared by time"):
        assert gt.score("one.csv", "truth.csv", metres=0.05).together.idf1 == 1.0
    assert gt.score("one.csv", "truth.csv", metres=0.05, frame_offset=-1).together.idf1 == 1.0


def test_a_pair_of_files(here):
    done = run("one.csv", "--truth", "truth.csv", "--json", "score.json")
    assert done.returncode == 0, done.stderr
    assert "within 1 m" in done.stdout and "HOTA" in done.stdout and "mostly lost" in done.stdout
    assert "together" not in done.stdout
    found = json.loads((here / "score.json").read_text())
    assert found["together"]["recall"] == 0.5 and found["together"]["idp"] == 1.0
    assert [one["name"] for one in found["sequences"]] == ["one"]
    assert found["sequences"][0] | {"name": "together"} == found["together"]


def test_a_report_has_the_figures_and_when_identities_were_switched(here):
    # From frame 10 on each has the other's identity.
    header, *rows = table().splitlines()
    cells = [row.split(",") for row in rows]
    lines = [",".join([str(3 - int(one)) if int(k) >= 10 else one, k, *rest]) for one, k, *rest in cells]
    (here / "swapped.csv").write_text("\n".join([header, *lines]) + "\n")
    done = run("swapped.csv", "--truth", "truth.csv", "--report", "report.html")
    assert done.returncode == 0, done.stderr
    assert "report: report.html" in done.stdout + done.stderr
    page = (here / "report.html").read_text()
    assert "Switches and fragmentations" in page and "HOTA" in page and "Identities over time" in page


def test_folders_of_files_with_the_same_names(here):
    (here / "true" / ".hidden").write_text("nothing")
    done = run("estimates", "--truth", "true", "--metres", "0.5", "--json", "score.json")
    assert done.returncode == 0, done.stderr
    assert "together" in done.stdout
    found = json.loads((here / "score.json").read_text())
    assert {one["name"]: one["matches"] for one in found["sequences"]} == {"a": 20, "b": 40}
    assert found["together"]["matches"] == 60 and found["together"]["rows"] == 80
    assert found["together"]["mean_distance"] == pytest.approx(0.2)
    assert found.pop("states")["rows"]
    assert gt.score("estimates", "true", metres=0.5).to_dict() == found


def test_what_a_reader_finds_beside_a_file_is_no_sequence(here):
    (here / "true" / "seqinfo.ini").write_text("[Sequence]\nframeRate=10\n")
    assert run("estimates", "--truth", "true").returncode == 0


def test_boxes_in_the_image(here):
    done = run("boxes.txt", "--truth", "truth.txt", "--iou", "0.5", "--json", "score.json")
    assert done.returncode == 0, done.stderr
    assert "marked to be ignored" in done.stderr and "IoU from 0.5" in done.stdout
    found = json.loads((here / "score.json").read_text())["together"]
    assert (found["matches"], found["misses"], found["false_positives"]) == (20, 20, 0)
    assert found["motp"] == pytest.approx(30 / 50) and found["mean_distance"] is None


def test_boxes_on_the_ground(here):
    (here / "plane.txt").write_text("0.01 0 0\n0 0.01 0\n0 0 1\n")
    done = run(
        "boxes.txt", "--truth", "truth.txt", "--homography", "plane.txt", "--fps", "10", "--json", "s.json"
    )
    assert done.returncode == 0, done.stderr
    assert json.loads((here / "s.json").read_text())["together"]["mean_distance"] == pytest.approx(0.1)


def test_boxes_of_town_centre(here):
    rows = "".join(",".join(line.split(",")[:6]) + "\n" for line in mot().splitlines())
    (here / "boxes.csv").write_text(rows)
    done = run("boxes.csv", "--truth", "truth.txt", "--iou", "1", "--json", "s.json")
    assert done.returncode == 0, done.stderr
    assert json.loads((here / "s.json").read_text())["together"]["hota"] == 1.0


WRONG = {
    "no truth": ("one.csv", "Missing option '--truth'"),
    "no boxes": ("one.csv --truth truth.txt --iou 0.5", "the format csv, which has no boxes"),
    "no frame in common": ("later.csv --truth truth.csv", "no frame in common"),
    "a truth without identities": ("boxes.txt --truth detections.txt --iou 0.5", "rows without identities"),
    "a row twice": ("boxes.txt --truth twice.txt --iou 0.5", "track 2 again in frame 0"),
    "a truth without boxes": ("boxes.txt --truth nowhere.txt --iou 0.5", "nowhere.txt: found no boxes"),
    "no camera": ("boxes.txt --truth truth.txt", "no camera for the estimates"),
    "a report of boxes": ("boxes.txt --truth truth.txt --iou 0.5 --report r.html", "--report and --iou"),
    "a report of several": ("estimates --truth true --report r.html", "--report of 2 sequences"),
    "a report over the truth": ("one.csv --truth truth.csv --report truth.csv", "--report"),
    "a folder and a file": ("estimates --truth true/a.csv", "nothing to go with b.csv, expected the truth"),
    "other names": ("estimates --truth other", "nothing to go with b.csv"),
    "estimates of fewer": ("estimates/a.csv --truth true", "nothing to go with b.csv, expected estimates"),
    "one name twice": ("estimates/a.csv other/a.csv --truth true", "expected a name for each sequence"),
    "an empty folder": ("empty --truth true", "a folder without files"),
    "a missing file": ("missing.csv --truth truth.csv", "missing.csv"),
    "JSON in the truth's place": ("one.csv --truth truth.csv --json truth.csv", "the input would be lost"),
    "JSON in no folder": ("one.csv --truth truth.csv --json missing/score.json", "no folder missing"),
    "a selection of boxes": ("boxes.txt --truth truth.txt --iou 0.5 --select 1", "--select and --iou"),
}


@pytest.mark.parametrize(("arguments", "said"), WRONG.values(), ids=WRONG)
def test_wrong_use_is_one_line_with_status_2(arguments, said, here):
    before = {path: path.stat().st_mtime_ns for path in here.rglob("*")}
    done = run(*arguments.split())
    errors = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert done.returncode == 2 and len(errors) == 1 and said in errors[0]
    assert done.stdout == "" and "Traceback" not in done.stderr
    assert {path: path.stat().st_mtime_ns for path in here.rglob("*")} == before


def test_the_sequence_without_a_frame_in_common_is_named(here):
    (here / "true" / "b.csv").write_text(table(frames=range(50, 60)))
    with pytest.raises(InputError, match=r"^b: found no frame in common: estimates in frames 0 to 19"):
        gt.score("estimates", "true")
