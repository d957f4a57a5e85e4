"""Random changes of the bytes, cells and lines of a file."""

import numpy as np

JUNK = (
    *b"nan NaN inf -inf 1e300 -1e300 1e-320 1e9999 -1 0 1.5 x \x00 \xff\xfe \xc3\xa9 1_000 0x10".split(b" "),
    *(b"9" * 40, b"", b'"', b"'", b",", b" ", b"\t", b"\n", b"\r", b"- (2D point"),
    *b"\xd9\xa3 < &lol; - # = PAR1 \x1f\x8b".split(b" "),
)


def mutate(data: bytes, rng: np.random.Generator) -> bytes:
    """One to three random changes of bytes, cells or lines."""
    for _ in range(rng.integers(1, 4)):
        data = MUTATIONS[rng.integers(len(MUTATIONS))](data, rng)
    return data


def flip_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.integers(1, 6)):
        if changed:
            changed[rng.integers(len(changed))] ^= int(rng.integers(1, 256))
    return bytes(changed)


def truncate(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: rng.integers(len(data) + 1)]


def change_lines(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.split(b"\n")
    i, j = rng.integers(len(lines), size=2)
    action = rng.integers(3)
    if action == 0:
        del lines[i]
    elif action == 1:
        lines.insert(j, lines[i])
    else:
        lines[i], lines[j] = lines[j], lines[i]
    return b"\n".join(lines)


def change_cells(data: bytes, rng: np.random.Generator) -> bytes:
    """Swap two cells of a line, or put junk in place of one."""
    lines = data.split(b"\n")
    i = int(rng.integers(len(lines)))
    mark = b"," if b"," in lines[i] else b'"' if b'"' in lines[i] else b" "
    cells = lines[i].split(mark)
    a, b = rng.integers(len(cells), size=2)
    if rng.integers(2):
        cells[a], cells[b] = cells[b], cells[a]
    else:
        cells[a] = JUNK[rng.integers(len(JUNK))]
    lines[i] = mark.join(cells)
    return b"\n".join(lines)


def insert_junk(data: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(len(data) + 1))
    return data[:at] + JUNK[rng.integers(len(JUNK))] + data[at:]


MUTATIONS = (flip_bytes, truncate, change_lines, change_cells, insert_junk)
