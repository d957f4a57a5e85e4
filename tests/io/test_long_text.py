"""Long texts of few characters: every reader ends soon, since it works in linear time."""

import os
import random
import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

LENGTH = 2**20
HANG = 900.0
"""Seconds of a part of the readers, which need some for all texts; quadratic time would be hours."""

CHARACTERS = [bytes([code]) for code in range(128)]
PAIRS = [first + second for first in CHARACTERS for second in CHARACTERS if first != second]
PARTS = 4

SEED = int(os.environ.get("GRAPHTRACK_FUZZ_SEED", "0"))
"""``make test-all`` sets that of the day."""


def texts(seed: int, singles: int, pairs: int) -> Iterator[bytes]:
    """Yield a mebibyte of each of so many characters, and of so many pairs of them."""
    chosen = random.Random(seed)
    yield from (character * LENGTH for character in chosen.sample(CHARACTERS, singles))
    yield from (pair * (LENGTH // 2) for pair in chosen.sample(PAIRS, pairs))


def contents(content: bytes, text: bytes) -> Iterator[bytes]:
    """Yield the text alone, and within the first line and the middle of a valid content."""
    first, _, rest = content.partition(b"\n")
    middle = len(first) // 2
    yield text
    yield first[:middle] + text + first[middle:] + b"\n" + rest
    yield content[: len(content) // 2] + text + content[len(content) // 2 :]


def read_all(part: int, seed: int, singles: int, pairs: int) -> None:
    """Read texts with a part of the readers; what is read is printed before, so that a hang names it."""
    from input_readers import OPTION_FILES, format_readers

    from graphtrack.errors import GraphtrackError

    warnings.simplefilter("ignore")
    with TemporaryDirectory() as folder:
        for k, one in enumerate((*OPTION_FILES, *format_readers(Path(folder)))):
            if k % PARTS != part:
                continue
            for text in texts(seed + k, singles, pairs):
                for place, content in enumerate(contents(one.content, text)):
                    print(one.label, text[:2], place, flush=True)
                    try:
                        one.read(one.write(Path(folder) / "long", content))
                    except GraphtrackError as error:
                        assert "\n" not in str(error) and len(str(error)) < 4000


@pytest.mark.parametrize(
    ("singles", "pairs"),
    [pytest.param(1, 1, id="some"), pytest.param(128, 64, id="all", marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("part", range(PARTS))
def test_a_mebibyte_of_few_characters_is_read_or_refused_soon(part: int, singles: int, pairs: int) -> None:
    command = [sys.executable, __file__, *map(str, (part, SEED, singles, pairs))]
    hang = HANG if singles < len(CHARACTERS) else 4 * HANG
    done = subprocess.run(command, capture_output=True, text=True, timeout=hang, check=False)
    assert done.returncode == 0, (done.stdout[-200:], done.stderr[-2000:])


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1] / "support"))
    read_all(*map(int, sys.argv[1:]))
