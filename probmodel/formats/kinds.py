"""What a file is that no reader here takes: the kind that its first bytes speak of, in words.

Told from the beginnings that the formats' own descriptions require, so that whoever gives a photo,
a video or markers reads what it was taken for, and what to do."""

from collections.abc import Sequence

from poseterior.probmodel.formats.common import Content

_POSES = "3D poses are for check, learn, evaluate and coverage; give 2D joints here"
_DETECT = "run a detector on it, and give its file of 2D joints"
_PICKLE = "pickles, which could run any code, are not read; save it as JSON or plain arrays"
_UNPACK = "unpack it, and give the file of 2D joints inside"
_RECODE = "save it as UTF-8"
_EXPORT = "have it exported as JSON or CSV"
BEGINNINGS: tuple[tuple[int, bytes, str, str], ...] = (
    (0, b"\xff\xd8\xff", "a photo (JPEG)", _DETECT),
    (0, b"\x89PNG\r\n\x1a\n", "an image (PNG)", _DETECT),
    (0, b"GIF8", "an image (GIF)", _DETECT),
    (0, b"II*\x00", "an image (TIFF)", _DETECT),
    (0, b"MM\x00*", "an image (TIFF)", _DETECT),
    (8, b"WEBP", "an image (WebP)", _DETECT),
    (8, b"AVI ", "a video (AVI)", _DETECT),
    (4, b"ftyp", "a video (MP4 or QuickTime)", _DETECT),
    (0, b"\x1aE\xdf\xa3", "a video (Matroska or WebM)", _DETECT),
    (0, b"HIERARCHY", "motion capture (BVH)", _POSES),
    (0, b"PathFileType", "a TRC file of markers", _POSES),
    (0, b":FULLY-SPECIFIED", "motion capture (AMC)", _POSES),
    (0, b"#!OML:ASF", "motion capture (AMC)", _POSES),
    (0, b"# AST/ASF", "a skeleton of motion capture (ASF)", _POSES),
    (0, b":version", "a skeleton of motion capture (ASF)", _POSES),
    (0, b"MATLAB 5.0 MAT-file", "a MATLAB file", "save its joints as JSON, CSV or .npy"),
    (0, b"%PDF", "a PDF", "give a file of 2D joints"),
    (0, b"\x1f\x8b", "packed by gzip", _UNPACK),
    (0, b"\xff\xfe", "UTF-16 text", _RECODE),
    (0, b"\xfe\xff", "UTF-16 text", _RECODE),
    (0, b"7z\xbc\xaf\x27\x1c", "packed by 7-Zip", _UNPACK),
    (0, b"Rar!", "packed by RAR", _UNPACK),
    (0, b"\x80\x02", "a pickle", _PICKLE),
    (0, b"\x80\x03", "a pickle", _PICKLE),
    (0, b"\x80\x04", "a pickle", _PICKLE),
    (0, b"\x80\x05", "a pickle", _PICKLE),
    (0, b"SQLite format 3\x00", "an SQLite database", _EXPORT),
    (0, b"<?xml", "XML", _EXPORT),
    (0, b"<!DOCTYPE html", "a web page, perhaps of a download that failed", "fetch it again"),
    (0, b"<html", "a web page, perhaps of a download that failed", "fetch it again"),
    (0, b"%YAML", "YAML", "save it as JSON"),
    (0, b"version https://git-lfs", "a pointer of Git LFS, not the file", "run git lfs pull"),
)
"""Where a kind's mark stands, the mark, the kind in words, and what to do."""
_C3D = 0x50
"""The second byte of every C3D file; the first says in which block the parameters begin."""


MEMBERS: tuple[tuple[str, str, str], ...] = (
    ("xl/", "an Excel workbook", "save its sheet as CSV"),
    ("content.xml", "a spreadsheet (OpenDocument)", "save its sheet as CSV"),
    ("/data.pkl", "a PyTorch checkpoint, which holds pickles", _PICKLE),
)
"""How a name in a ZIP archive begins or ends, the kind in words, and what to do."""
_TRAINING = "it does not say the order of its points; save them by their names, as a table"
ARRAYS: tuple[tuple[set[str], str, str], ...] = (
    ({"imgname", "center", "scale"}, "a data set for training, such as SPIN's", _TRAINING),
    ({"positions_3d"}, "VideoPose3D's 3D poses", _POSES),
    ({"posterior/joints"}, "a result of poseterior", "give it to check, show or export"),
)
"""Arrays that a kind's files hold, the kind in words, and what to do."""


def seeming(content: Content) -> str | None:
    """The kind that a file seems to be, and what to do, for a sentence; None where it is none of
    those known."""
    data = content.data
    for place, mark, kind, advice in BEGINNINGS:
        if data.startswith(mark, place):
            return f"{kind}; {advice}"
    if len(data) >= 512 and data[1] == _C3D and 0 < data[0] < 128 and b"\x00" in data[:512]:
        return f"a C3D file of markers; {_POSES}"
    if members := content.arrays.strangers():
        return _of_archive(members)
    found = set(content.arrays.names())
    for names, kind, advice in ARRAYS:
        if names <= found and "preds" not in found:
            return f"{kind}; {advice}"
    return None


def _of_archive(members: Sequence[str]) -> str:
    for mark, kind, advice in MEMBERS:
        if any(name.startswith(mark) or name.endswith(mark) for name in members):
            return f"{kind}; {advice}"
    return f"a ZIP archive; {_UNPACK}"
