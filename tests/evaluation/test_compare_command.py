"""`graphtrack compare` on minimal input: one clear error, or an answer with its limitations."""

import json
import math
import sys

import numpy as np
import pytest

from graphtrack.cli import main

ALL = "kf,intentional,intentional-printed,intentional-consistent,particle,chain,fixed-lag,isam2,rts,ffbs"
ALL += ",smoother"
HEAD = "track_id,frame,t,x,y,body_deg,head_deg,true_x,true_y,true_body_deg,true_head_deg\n"


def rows(track, seen, n=12, jump=None, head=True):
    """A person who walks along x, with positions in the frames ``seen``."""
    rng = np.random.default_rng(track)
    text = ""
    for k in range(n):
        place = 0.12 * k + (500.0 if jump is not None and k >= jump else 0.0)
        x, y = np.array([place, 0.0]) + rng.normal(0.0, 0.05, 2)
        position = f"{x:.3f},{y:.3f}" if k in seen else ","
        facing = f"{rng.normal(0.0, 10.0):.1f}" if head else ""
        text += f"{track},{k},{k / 10:.1f},{position},,{facing},{place:.3f},0,0,0\n"
    return text


@pytest.fixture
def compare(cwd, monkeypatch, capsys):
    """From a file's text and options to the exit status, the messages, and the JSON if there is one."""

    def run(text, methods=ALL, *options):
        (cwd / "tracks.csv").write_text(text)
        arguments = ["compare", "tracks.csv", "--methods", methods, "--json", "found.json", *options]
        monkeypatch.setattr(sys, "argv", ["graphtrack", *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
        output = capsys.readouterr()
        assert "Traceback" not in output.err + output.out
        found = cwd / "found.json"
        return ended.value.code, output.err, json.loads(found.read_text()) if found.is_file() else None

    return run


def test_a_head_column_without_position_columns(compare):
    text = "track_id,frame,t,head_deg,true_x,true_y\n" + "".join(f"1,{k},{k},3,{k},0\n" for k in range(9))
    status, said, _ = compare(text)
    assert status == 2
    assert said.startswith("error: tracks.csv: found no position, expected columns x, y")


@pytest.mark.slow
@pytest.mark.parametrize("n", [1, 12])
def test_one_observation_is_enough_for_all(compare, n):
    status, _, found = compare(HEAD + rows(1, (0,), n))
    assert status == 0
    assert not [record for record in found["per_track"] if record["failure"]]
    errors = {r["method"]: r["median"] for r in found["rows"] if r["metric"] == "position RMSE"}
    assert set(errors) == set(ALL.split(","))
    assert all(math.isfinite(error) and error < 3.0 for error in errors.values())


def test_weights_that_all_vanish_are_recovered_from_and_said_once(compare):
    text = HEAD + rows(1, range(12), jump=6)
    status, said, found = compare(text, "particle,ffbs")
    assert status == 0
    told = [line for line in said.splitlines() if "no particle was near the observation at frame 6" in line]
    assert len(told) == 1 and told[0].startswith("  note: track 1")
    errors = [r["median"] for r in found["rows"] if r["metric"] == "position RMSE"]
    assert len(errors) == 2 and max(errors) < 0.2


def test_a_model_that_no_method_knows_is_one_error(compare):
    text = HEAD + rows(1, range(12))
    status, said, found = compare(text, "particle", "--model", "social")
    assert status == 2 and found is None
    assert "particle filter does not know" in said.splitlines()[-1]
    status, said, found = compare(text, "kf,particle", "--model", "social")
    assert status == 0 and "particle failed on track 1" in said
    assert {row["method"] for row in found["rows"]} == {"kf"}


OWN = {"kf": "position", "intentional": "intentional", "particle": "joint", "chain": "joint"}
OWN |= {"fixed-lag": "joint", "isam2": "joint", "rts": "position", "ffbs": "joint", "smoother": "joint"}
OWN |= {"intentional-printed": "", "intentional-consistent": ""}  # no model, parameters of their paper


@pytest.mark.slow
def test_each_method_has_its_best_model_and_the_table_and_caption_say_which(compare):
    status, said, found = compare(HEAD + rows(1, range(12)))
    assert status == 0 and not [record for record in found["per_track"] if record["failure"]]
    assert found["models"] == OWN == {row["method"]: row["model"] for row in found["rows"]}
    assert "position for kf" in said and "joint for particle" in said
