"""When the people of a stream are written."""

from types import SimpleNamespace

from graphtrack.cli.saving import Saving
from graphtrack.cli.state_file import StateFile


def writings(path, seconds):
    """Times at which a stream of nobody is written, every ten seconds, after it began at 0."""
    now, found = 0.0, []
    nobody = SimpleNamespace(rows=0, line=0, members={}, before_change=None)
    file = StateFile(path, 3600.0)
    saving = Saving(file, nobody, {}, 10.0, lambda: now)
    saving.begin()
    before = path.stat().st_ino
    while now < seconds:
        now += 0.25
        saving.tend()
        saving.tend()
        file.wait()
        if path.stat().st_ino != before:
            before = path.stat().st_ino
            found.append(now)
    file.close()
    return found


def test_streams_that_begin_together_are_written_at_different_times(tmp_path):
    first, second = zip(*(writings(tmp_path / f"stream{k}", 20.0)[:2] for k in range(8)), strict=True)
    assert max(first) <= 10.25 and len(set(first)) >= 5
    assert all(after - before in (10.0, 10.25) for before, after in zip(first, second, strict=True))
