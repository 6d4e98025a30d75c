"""What files and terminals are given: plain values, files that are whole or not there, streams that take all text.

Text that a stream cannot encode is written in words of ASCII: ν as nu, kg/m³ as kg/m^3.
"""

from __future__ import annotations

import codecs
import contextlib
import math
import os
import sys
import unicodedata
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO, cast

IN_WORDS = "finger_sim.words"
"""Name of the error handler that puts what an encoding lacks in words."""
REPLACED = ("strict", "surrogateescape", "backslashreplace")
"""Error handlers that give way to it; one that the user chose, as PYTHONIOENCODING=ascii:replace does, stays."""
LOST = 1
"""Exit code of work that was done, but whose output could not be written."""

_WORDS = {
    "–": "-", "−": "-", "…": "...", "×": "x", "·": "*", "±": "+-", "→": "->", "√": "sqrt ", "≥": ">=", "≤": "<=",
    "≈": "~", "∞": "inf", "°": " deg", "µ": "u", "∂": "d", "“": '"', "”": '"', "’": "'", "λ": "lambda",
}  # fmt: skip


def plain(value: Any) -> Any:
    """Arrays and tuples as lists, no NumPy numbers, keys as text, what is not finite as null; all else as it is."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """Where to write what `path` is to hold; it is put there when the `with` block ends well.

    Whatever ends the block otherwise, an interrupt too, leaves what was at `path` before, or nothing. The name given
    has the same ending. What is no file, such as /dev/stdout, is written to directly, as far as its reader reads.
    Raises OSError when the file cannot be put in its place.
    """
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        with contextlib.suppress(BrokenPipeError):
            yield Path(path)
        return
    part = target.with_name(f".{target.stem}.{os.getpid()}{target.suffix}")
    try:
        yield part
        part.replace(target)
    finally:
        part.unlink(missing_ok=True)


def in_words(text: str, encoding: str) -> str:
    """The text with what the encoding lacks in words."""
    return text.encode(encoding, IN_WORDS).decode(encoding, "surrogateescape")


def _word(character: str) -> str:
    """One character in ASCII: a Greek letter by its name, an index by its digit; else as Python writes it."""
    if character in _WORDS:
        return _WORDS[character]
    greek, _, letter = unicodedata.name(character, "").partition(" LETTER ")
    if greek in ("GREEK SMALL", "GREEK CAPITAL") and letter.isalpha():
        return letter.lower() if greek == "GREEK SMALL" else letter.capitalize()
    kind, _, code = unicodedata.decomposition(character).partition(" ")
    if kind in ("<super>", "<sub>") and len(code) == 4 and (base := chr(int(code, 16))).isascii():
        return f"^{base}" if kind == "<super>" else base
    return character.encode("ascii", "backslashreplace").decode("ascii")


def _put_in_words(error: UnicodeError) -> tuple[str | bytes, int]:
    """The error handler; bytes of a file's name that are no text go out as they are."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    wrong = error.object[error.start : error.end]
    if all("\udc80" <= character <= "\udcff" for character in wrong):
        return wrong.encode("utf-8", "surrogateescape"), error.end
    return "".join(map(_word, wrong)), error.end


codecs.register_error(IN_WORDS, _put_in_words)


class _Stream:
    """A standard stream that work writes to whatever becomes of it: what cannot be written is dropped.

    lost : why not everything was written; None where a reader closed its pipe, as `head` does, or all was
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._ended = False
        self.lost: OSError | None = None
        self._errors = getattr(stream, "errors", None)
        self._reconfigure(IN_WORDS if self._errors in REPLACED else self._errors)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        if not self._ended:
            self._try(lambda: self._stream.write(text))
        return len(text)

    def flush(self) -> None:
        if not self._ended:
            self._try(self._stream.flush)

    def restore(self) -> TextIO:
        """The stream as it was, with nothing left to be written."""
        self.flush()
        self._reconfigure(self._errors)
        return self._stream

    def _try(self, work: Callable[[], object]) -> None:
        try:
            work()
        except OSError as error:
            self._ended = True
            self.lost = None if isinstance(error, BrokenPipeError) else error
            self._drain()

    def _drain(self) -> None:
        """What waits to be written, here and in processes that inherit the stream, goes nowhere."""
        with contextlib.suppress(OSError, ValueError):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())
            os.close(nowhere)
            self._stream.flush()

    def _reconfigure(self, errors: str | None) -> None:
        reconfigure = getattr(self._stream, "reconfigure", None)
        if reconfigure is not None and errors is not None:
            with contextlib.suppress(OSError):
                reconfigure(errors=errors)


def printing(name: str, work: Callable[[], int | None]) -> int:
    """The exit code of work that prints, whatever stdout and stderr are; None stands for 0.

    What an encoding lacks is put in words. A stream that is closed, or whose reader goes, as `head` does, takes the
    rest in silence, and the code is that of the work. Where stdout cannot be written otherwise, on a full disk, the
    work is done to its end, one line on stderr begins with `name`, and the code is LOST instead of 0.
    Raises SystemExit where the work does, by the same rule.
    """
    if isinstance(sys.stdout, _Stream):
        return work() or 0
    occupy()
    out, err = _Stream(sys.stdout), _Stream(sys.stderr)
    sys.stdout, sys.stderr = cast(TextIO, out), cast(TextIO, err)
    try:
        code = work() or 0
        return LOST if _told(out, err, name) and code == 0 else code
    except SystemExit as end:
        if _told(out, err, name) and end.code in (0, None):
            raise SystemExit(LOST) from None
        raise
    finally:
        sys.stdout, sys.stderr = out.restore(), err.restore()


def _told(out: _Stream, err: _Stream, name: str) -> bool:
    """Whether output was lost; stderr says so."""
    out.flush()
    if out.lost is not None:
        err.write(f"{name}: error: stdout: cannot be written: {out.lost.strerror or out.lost}\n")
    return out.lost is not None


def occupy() -> None:
    """Opens nowhere in place of standard streams that are closed: no file and no socket becomes one of them."""
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(number, True)
    os.close(number)
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
