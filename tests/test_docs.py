"""The commands of the other documents run as printed, each document in an empty folder from top to bottom."""

import re
import shutil
from pathlib import Path

import pytest
from documents import RECORDING, ROOT, blocks, is_about_recording, run

GUIDE = ROOT / "docs" / "how-to"  # of test_howto
PAGES = sorted(str(path.relative_to(ROOT)) for path in (ROOT / "docs").rglob("*.md") if path.parent != GUIDE)
WITH_COMMANDS = [page for page in PAGES if any(block.kind == "sh" for block in blocks(page))]


def test_commands_stand_where_they_are_run():
    assert {"docs/perception.md", "docs/trackers.md"} <= set(WITH_COMMANDS)
    for page in PAGES:  # and not in blocks of another kind
        text = (ROOT / page).read_text(encoding="utf-8")
        assert not re.findall(r"^    (?:graphtrack|perception) .*", text, flags=re.M), page


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_COMMANDS)
def test_the_commands_of_a_page_run(page, cwd):
    run(blocks(page), {}, slow=True)


@pytest.mark.slow
def test_the_commands_about_a_recording_run(data_dir, cwd):
    street = data_dir / "towncentre"
    (cwd / RECORDING).symlink_to(street / "frames_001_150" / "img1")
    for name in ("frames_001_150/det.txt", "calibration.ci"):
        shutil.copyfile(street / name, cwd / Path(name).name)
    about = [block for block in blocks("docs/perception.md") if is_about_recording(block)]
    assert len(about) >= 4
    run(about, {}, slow=True)
