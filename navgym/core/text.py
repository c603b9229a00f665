"""The text of a file: packed by gzip or not, in any usual encoding, never more than was asked for."""

from __future__ import annotations

import codecs
import gzip
import zlib
from pathlib import Path
from typing import BinaryIO, cast

from navgym.core.checks import within

LARGEST = 2e9  # bytes of text that are read unless more are asked for
LONGEST_LINE = 1_000_000  # bytes: a longer line is no row of a table
BLOCK = 1 << 20
BYTE_ORDER_MARKS = {
    codecs.BOM_UTF8: "utf-8", codecs.BOM_UTF32_LE: "utf-32-le", codecs.BOM_UTF32_BE: "utf-32-be",
    codecs.BOM_UTF16_LE: "utf-16-le", codecs.BOM_UTF16_BE: "utf-16-be",
}  # fmt: skip
ARCHIVES = {b"PK\x03\x04": "zip", b"BZh": "bzip2", b"\xfd7zXZ\x00": "xz", b"(\xb5/\xfd": "zstd"}
CONTROLS = bytes({*range(9), *range(14, 32), 127} - {26, 27})  # hardly ever in text


def read_text(
    source: Path, encoding: str | None = None, largest: float = LARGEST
) -> tuple[bytes, list[str]]:
    r"""Text of a file as UTF-8 with lines that end in "\n", and sentences about what was done.

    Args:
        source: the file; one that gzip packed, whatever its name, is unpacked.
        encoding: of the text; by default by its byte order mark, else UTF-8, else Latin-1.
        largest: bytes, after unpacking.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: a folder, a binary file, a damaged or another archive, too many bytes, a text
            that is not in `encoding`, an unknown encoding, a line of over `LONGEST_LINE` bytes.
    """
    within("largest", largest, 1.0)
    content, said = _content(source, int(largest))
    text = _decoded(source, content, encoding, said).replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    stripped = text.rstrip(b"\0\n\x1a ")
    if b"\0" in text[len(stripped) :]:
        said.append("the file ends in NUL bytes, as after a loss of power: left out")
        text = stripped + b"\n"
    if b"\0" in text:
        line = text.count(b"\n", 0, text.index(b"\0")) + 1
        raise ValueError(
            f"{source.name} is a binary file, not text (NUL in line {line}): export it as CSV."
        )
    _refuse_long_lines(source, text)
    return text, said


def opened(source: Path) -> BinaryIO:
    """A file for reading bytes, unpacked on the way if gzip packed it."""
    with source.open("rb") as file:
        packed = file.read(2) == b"\x1f\x8b"
    return cast(BinaryIO, gzip.open(source)) if packed else source.open("rb")


def _content(source: Path, largest: int) -> tuple[bytes, list[str]]:
    if source.is_dir():
        raise ValueError(f"{source} is a folder: name the file in it.")
    try:
        with source.open("rb") as file:
            content = file.read(largest + 1)
    except FileNotFoundError:
        raise FileNotFoundError(f"{source} does not exist: check the path.") from None
    if content.startswith(b"\x1f\x8b"):
        return _unpacked(source, content, largest), ["unpacked by gzip"]
    for start, kind in ARCHIVES.items():
        if content.startswith(start):
            raise ValueError(
                f"{source.name} is a binary file, packed by {kind}: unpack it first (gzip is read)."
            )
    if len(content) > largest:
        raise _too_large(source, largest)
    return content, []


def _unpacked(source: Path, content: bytes, largest: int) -> bytes:
    """The members of a gzip file, one after the other, never more than `largest` bytes in memory."""
    parts, size = [], 0
    while content.startswith(b"\x1f\x8b"):
        machine = zlib.decompressobj(wbits=31)
        while not machine.eof:
            try:
                part = machine.decompress(content, BLOCK)
            except zlib.error as error:
                raise ValueError(f"{source.name} is a damaged gzip file: {error}.") from None
            content = machine.unconsumed_tail
            if not part and not content and not machine.eof:
                raise ValueError(f"{source.name} is a truncated gzip file: copy it again.")
            parts.append(part)
            size += len(part)
            if size > largest:
                raise _too_large(source, largest)
        content = machine.unused_data
    return b"".join(parts)


def _too_large(source: Path, largest: int) -> ValueError:
    return ValueError(
        f"{source.name} holds more than {largest:.3g} bytes of text: raise largest=, or cut it."
    )


def _decoded(source: Path, content: bytes, encoding: str | None, said: list[str]) -> bytes:
    """`content` as UTF-8 without a byte order mark."""
    mark = next((m for m in BYTE_ORDER_MARKS if content.startswith(m)), b"")
    guess = BYTE_ORDER_MARKS.get(mark) or _unmarked_utf16(content) or "utf-8"
    if encoding is None and content.isascii() and guess == "utf-8":
        return _printable(source, content)
    try:
        text = content[len(mark) :].decode(encoding or guess)
    except LookupError:
        raise ValueError(f"encoding {encoding!r} is unknown: 'utf-8' or 'latin-1'?") from None
    except UnicodeError as error:
        if encoding or guess != "utf-8":
            raise ValueError(f"{source.name} is not {encoding or guess} text ({error}).") from None
        text = _printable(source, content).decode("cp1252", errors="replace")
        said.append("the text is not UTF-8: read as Latin-1; encoding= says otherwise")
    if guess.startswith("utf-16"):
        said.append("the text is UTF-16")
    # the minus sign of typesetters, and blanks that do not break
    tidy = text.replace("\u2212", "-").replace("\u00a0", " ").encode("utf-8", errors="replace")
    return _printable(source, tidy)


def _unmarked_utf16(content: bytes) -> str | None:
    """UTF-16 of plain letters has a zero in every second byte."""
    head = content[:1000]
    zeros = [head[i::2].count(0) for i in (0, 1)]
    if len(head) > 3 and max(zeros) > 0.4 * len(head) and min(zeros) == 0:
        return "utf-16-be" if zeros[0] else "utf-16-le"
    return None


def _printable(source: Path, text: bytes) -> bytes:
    """`text`, unless more than one byte in a hundred of its beginning is a control character."""
    head = text[:10_000].rstrip(b"\0")
    strange = len(head) - len(head.translate(None, CONTROLS))
    if strange > 0.01 * len(head):
        raise ValueError(f"{source.name} is a binary file, not text: export it as CSV.")
    return text


def _refuse_long_lines(source: Path, text: bytes) -> None:
    start = line = 0
    while len(text) - start > LONGEST_LINE:
        end = text.rfind(b"\n", start, start + LONGEST_LINE)
        if end < 0:
            line += 1
            raise ValueError(
                f"{source.name}, line {line}: longer than {LONGEST_LINE} bytes: this is no table "
                "of rows; check what ends its lines."
            )
        line += text.count(b"\n", start, end + 1)
        start = end + 1
