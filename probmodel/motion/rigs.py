"""Skeletons of animation: which of a rig's joints are our fifteen, by their names.

Known are the names of the CMU conversions, of Mixamo, Rokoko, Xsens, Noitom, OptiTrack, Poser, Daz,
Unity's humanoid, VRM, Unreal's mannequin, 3ds Max' Biped, Valve's, Blender's Rigify, Auto-Rig Pro,
Character Creator, Maya's Advanced Skeleton, DeepMotion, Kinect, Bandai-Namco, SMPL, and
those that `poseterior export` writes. A prefix or a suffix that most share is stripped
(`mixamorig:`, a subject's name, `_JNT`). Each part of the body is looked for by itself, in the
first naming of it that is there: a rig's LeftShoulder is the shoulder only where there is no
LeftArm beyond it."""

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.skeleton import JOINTS

END = " end"
"""What is added to a joint's name to name its End Site."""
SIDES = ("right", "left")
_CENTRES = {
    "pelvis": ("hips", "pelvis", "hip", "midhip", "spinebase", "rootm", "rootx"),
    "thorax": (
        *("lowerneck", "necklower", "neck", "neck1", "neck01", "necktwist01", "neckbase"),
        "spineshoulder",
    ),
    "head": ("headtop", "headtopend", "headend", "head1end", "headxend", "headnub"),
}
_MARKS = (("", ""), ("c", ""), ("", "m"), ("", "x"))
"""What rigs put before or behind the names of what is in the middle: VRM, Maya's and Auto-Rig
Pro."""
_RIGIFY = {"pelvis": "spine", "thorax": "spine004", "head": "spine006end"}
"""Where the spine is numbered from the hips to the head."""
_LIMB_NAMES = {
    ("shoulder", "elbow", "wrist"): (
        ("arm", "forearm", "hand"),
        ("upperarm", "lowerarm", "hand"),
        ("upperarm", "forearm", "hand"),
        ("uarm", "farm", "hand"),
        ("shldr", "forearm", "hand"),
        ("shldrbend", "forearmbend", "hand"),
        ("armstretch", "forearmstretch", "hand"),
        ("shoulder", "elbow", "wrist"),
        ("shoulder", "elbow", "hand"),
    ),
    ("hip", "knee", "ankle"): (
        ("upleg", "leg", "foot"),
        ("upperleg", "lowerleg", "foot"),
        ("thigh", "shin", "foot"),
        ("thigh", "calf", "foot"),
        ("thigh", "leg", "foot"),
        ("leg", "shin", "foot"),
        ("thighbend", "shin", "foot"),
        ("thighstretch", "legstretch", "foot"),
        ("hip", "knee", "ankle"),
        ("hip", "knee", "foot"),
    ),
}
"""Our joints of a limb, and what rigs call them."""
_PREFIX = re.compile(r"(?:.*:|mixamorig\d*[:_]?|bip\d*[ _]|def-|.*\|)", re.IGNORECASE)
_FIRST_WORD = re.compile(r"[^_ .-]+[_ .-]+")
_LAST_WORD = re.compile(rf"[_ .-]+[^_ .-]+?(?=(?:{END})?$)")


def joints_of_rig(
    names: Sequence[str], path: Path, given: Mapping[str, str] | None = None
) -> list[int]:
    """Which joints of a rig our fifteen are.

    Parameters
    ----------
    names
        The rig's joints; that of an End Site is its joint's and `END`.
    path
        The file, for messages.
    given
        The rig's names → ours, as the user says them; others are looked for.

    Returns
    -------
    list of int
        Fifteen indices, in the order of `skeleton.JOINTS`.

    Raises
    ------
    BadInput
        Where joints cannot be found, or the user names one that is not there.
    """
    chosen = _given(names, path, given or {})
    plain = _plain(names)
    found = {**_centres(plain), **_limbs(plain), **chosen}
    missing = [joint for joint in JOINTS if joint not in found]
    if missing:
        raise BadInput(
            f"{path}: the skeleton has no joint that is known as {', '.join(missing)}, but"
            f" {shown(list(names))}; give a map of its names (names; on the command line --names"
            " names.json) to ours"
        )
    return [found[joint] for joint in JOINTS]


def _given(names: Sequence[str], path: Path, given: Mapping[str, str]) -> dict[str, int]:
    """By our joint, the index of the one that the user names."""
    chosen = {}
    for theirs, ours in given.items():
        if ours not in JOINTS:
            raise BadInput(
                f"{shown(ours)} is no joint; a map of names leads to {', '.join(JOINTS)}"
            )
        if theirs in names:
            chosen[ours] = list(names).index(theirs)
    if given and not chosen:
        raise BadInput(
            f"{path}: none of the names that were given ({shown(list(given))}) is a joint's, but"
            f" {shown(list(names))} are; an End Site is its joint's name and {END.strip()!r}"
        )
    return chosen


def _plain(names: Sequence[str]) -> dict[str, int]:
    """By name without what most share, in lower-case letters and digits, the first joint of that
    name."""
    stripped = [_PREFIX.sub("", name, count=1) for name in names]
    while shared := _shared(_FIRST_WORD.match, stripped):
        stripped = [name.removeprefix(shared) for name in stripped]
    if shared := _shared(_LAST_WORD.search, stripped):
        stripped = [name.replace(f"{shared}{END}", END).removesuffix(shared) for name in stripped]
    plain: dict[str, int] = {}
    for index, name in enumerate(stripped):
        plain.setdefault(re.sub(r"[^a-z0-9]", "", name.lower()), index)
    return plain


def _shared(word: Callable[[str], re.Match[str] | None], names: Sequence[str]) -> str:
    """The first or last word of more than half of the names, with the mark that sets it apart."""
    words = Counter(match[0] for name in names if (match := word(name)))
    shared, count = max(words.items(), key=lambda item: item[1], default=("", 0))
    return shared if 2 * count > len(names) else ""


def _centres(plain: Mapping[str, int]) -> dict[str, int]:
    found: dict[str, int | None] = {}
    for ours, theirs in _CENTRES.items():
        ways = (f"{left}{name}{right}" for left, right in _MARKS for name in theirs)
        found[ours] = next((plain[way] for way in ways if way in plain), None)
    if _RIGIFY["thorax"] in plain:
        found |= {ours: plain.get(name) for ours, name in _RIGIFY.items()}
    return {ours: index for ours, index in found.items() if index is not None}


def _limbs(plain: Mapping[str, int]) -> dict[str, int]:
    """Joints of arms and legs, each in the first naming of which most is there."""
    found: dict[str, int] = {}
    for ours, namings in _LIMB_NAMES.items():
        each = [_limb(plain, ours, theirs) for theirs in namings]
        longest: dict[str, int] = max(each, key=len)
        found.update(longest)
    return found


def _limb(plain: Mapping[str, int], ours: Sequence[str], theirs: Sequence[str]) -> dict[str, int]:
    """Both sides' joints of a limb in one naming."""
    pairs = [(side, *pair) for side in SIDES for pair in zip(ours, theirs, strict=True)]
    places = {f"{side}_{joint}": _of_side(plain, side, name) for side, joint, name in pairs}
    return {joint: place for joint, place in places.items() if place is not None}


def _of_side(plain: Mapping[str, int], side: str, name: str) -> int | None:
    ways = (f"{side}{name}", f"{name}{side}", f"{side[0]}{name}", f"{name}{side[0]}")
    return next((plain[way] for way in ways if way in plain), None)
