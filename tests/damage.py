"""Damaged copies of small good files: by seed, the kinds of damage that logs meet."""

import io
import json

import numpy as np

CELLS = (
    "", " ", "nan", "NaN", "inf", "-inf", "1e999", "1e308", "-1e308", "1e-320", "0", "-0", "-1",
    "1_000", "1,5", "0x1F", "١٢", "½", "1e", "--", "NULL", "null", "N/A", "true", '"', '"1', "'", "\\",
    "\ufeff1", "9" * 400, "2026-11-28T12:00:00Z", "12:00:00", "1;2", "-9999", "#", "\0", "time",
)  # fmt: skip


def damaged_text(content, rng):
    """Bytes of a text file after one to three kinds of damage."""
    for _ in range(rng.integers(1, 4)):
        content = TEXT[rng.integers(len(TEXT))](content, rng)
    return content


def damaged_npz(content, rng):
    """Bytes of an npz file, damaged as bytes or within."""
    if rng.random() < 0.4:
        return BYTES[rng.integers(len(BYTES))](content, rng)
    with np.load(io.BytesIO(content)) as file:
        arrays = {name: file[name] for name in file.files}
    for _ in range(rng.integers(1, 3)):
        name = rng.choice(sorted(arrays)) if arrays else "time"
        damage = ARRAYS[rng.integers(len(ARRAYS))]
        arrays = damage(arrays, str(name), rng)
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


# ---- bytes


def _span(content, rng):
    first, last = sorted(rng.integers(0, len(content) + 1, 2).tolist())
    return first, min(last, first + 200)


def flipped(content, rng):
    found = bytearray(content)
    for at in rng.integers(0, max(len(found), 1), rng.integers(1, 6)).tolist():
        if found:
            found[at % len(found)] = int(rng.integers(256))
    return bytes(found)


def cut(content, rng):
    return content[: rng.integers(0, len(content) + 1)]


def without_span(content, rng):
    first, last = _span(content, rng)
    return content[:first] + content[last:]


def span_twice(content, rng):
    first, last = _span(content, rng)
    return content[:last] + content[first:]


def zeros(content, rng):
    first, last = _span(content, rng)
    return content[:first] + bytes(last - first) + content[last:]


def noise(content, rng):
    at = int(rng.integers(0, len(content) + 1))
    return content[:at] + rng.bytes(int(rng.integers(1, 40))) + content[at:]


def foreign(content, rng):
    """Another file altogether."""
    others = (b"", b"\n", b"\xff\xfe", b"\x1f\x8b\x08\x00", b"PK\x03\x04", b"{}", rng.bytes(300))
    return others[rng.integers(len(others))]


BYTES = (flipped, cut, without_span, span_twice, zeros, noise, foreign)

# ---- lines and cells


def _lines(content):
    return content.decode("utf-8", errors="replace").split("\n")


def _written(lines):
    return "\n".join(lines).encode("utf-8", errors="replace")


def _delimiter(lines):
    return ";" if ";" in lines[0] else ","


def cell(content, rng, first=0):
    lines = _lines(content)
    mark = _delimiter(lines)
    at = int(rng.integers(min(first, len(lines) - 1), len(lines)))
    row = lines[at].split(mark)
    row[rng.integers(len(row))] = CELLS[rng.integers(len(CELLS))]
    lines[at] = mark.join(row)
    return _written(lines)


def row_of_numbers(content, rng):
    """A cell below the names, so that what is read has to be judged by its value."""
    return cell(content, rng, first=2)


def column(content, rng):
    """A whole column of one word, in place of the numbers."""
    lines = _lines(content)
    mark, word = _delimiter(lines), CELLS[rng.integers(len(CELLS))]
    j = int(rng.integers(len(lines[0].split(mark))))
    rows = [line.split(mark) for line in lines]
    for row in rows[2:]:
        if j < len(row):
            row[j] = word
    return _written([mark.join(row) for row in rows])


def scaled(content, rng):
    """Every number of a column in another unit."""
    lines = _lines(content)
    mark, factor = _delimiter(lines), 10.0 ** rng.integers(-300, 300)
    j = int(rng.integers(len(lines[0].split(mark))))
    rows = [line.split(mark) for line in lines]
    for row in rows:
        try:
            row[j] = repr(float(row[j]) * factor)
        except (IndexError, ValueError):
            continue
    return _written([mark.join(row) for row in rows])


def line_gone(content, rng):
    lines = _lines(content)
    del lines[rng.integers(len(lines))]
    return _written(lines or [""])


def line_twice(content, rng):
    lines = _lines(content)
    at = rng.integers(len(lines))
    lines.insert(int(rng.integers(len(lines) + 1)), lines[at])
    return _written(lines)


def shuffled(content, rng):
    lines = _lines(content)
    return _written([lines[0], *(lines[1:][k] for k in rng.permutation(len(lines) - 1))])


def few_rows(content, rng):
    return _written(_lines(content)[: rng.integers(1, 6)])


def other_marks(content, rng):
    old, new = rng.choice([",", ";", "\t", ".", "\n", "\r", "_", " "], 2)
    return content.replace(str(old).encode(), str(new).encode())


TEXT = (
    *BYTES, cell, cell, row_of_numbers, row_of_numbers, column, column, scaled, line_gone, line_twice,
    shuffled, few_rows, other_marks,
)  # fmt: skip

# ---- arrays


def _put(arrays, name, value):
    return {**arrays, name: value}


def array_gone(arrays, name, rng):
    return {n: a for n, a in arrays.items() if n != name}


def other_shape(arrays, name, rng):
    array = arrays[name]
    found = (array.ravel(), array[None], array[:1] if array.ndim else array, np.zeros((0, 3)),
             array.T, np.concatenate([np.atleast_1d(array)] * 2))  # fmt: skip
    return _put(arrays, name, found[rng.integers(len(found))])


def other_type(arrays, name, rng):
    array = arrays[name]
    found = (array.astype(str), np.array({"a": 1}), np.array(None), np.array("linear"),
             np.zeros(array.shape, "M8[s]"), np.zeros(array.shape, complex),
             np.zeros(array.shape, [("a", float)]), np.zeros(array.shape, bool))  # fmt: skip
    return _put(arrays, name, found[rng.integers(len(found))])


def other_values(arrays, name, rng):
    array = np.array(arrays[name])
    if array.dtype.kind not in "fiub" or not array.size:
        return arrays
    values = (np.nan, np.inf, -1.0, 0.0, 1e308, -1e308, 1e-320, 7.0)
    found = array.astype(float)
    where = rng.random(array.shape) < rng.choice([0.1, 1.0])
    found[where] = values[rng.integers(len(values))]
    return _put(arrays, name, found)


def other_header(arrays, name, rng):
    if "header" not in arrays:
        return arrays
    try:
        header = json.loads(str(arrays["header"]))
    except (ValueError, RecursionError):
        return arrays
    if not isinstance(header, dict):
        return arrays
    values = (None, 1, 99, "Recording", "DualIMURecording", "Policy", [], {}, [1], "x", 1e999)
    header[str(rng.choice(["navgym", "kind", "meta", "more"]))] = values[rng.integers(len(values))]
    texts = (json.dumps(header), json.dumps(header)[:20], "[]", "[" * 3000, "1", "")
    text = texts[0 if rng.random() < 0.6 else rng.integers(len(texts))]
    return _put(arrays, "header", np.array(text))


def array_more(arrays, name, rng):
    return _put(arrays, str(rng.choice(["more", "model.more", "truth", "regime", "theta"])), arrays.get(name, np.zeros(3)))  # fmt: skip


ARRAYS = (
    array_gone, other_shape, other_type, other_values, other_values, other_header, array_more,
)  # fmt: skip
