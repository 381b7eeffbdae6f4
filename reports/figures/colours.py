"""The colours of bodies and hypotheses, the same in pictures and on pages that turn, and what of a
body is drawn. Free of matplotlib, so that a page need not wait for it."""

from poseterior.probmodel.skeleton import GROUPS, NUM_JOINTS, PARENTS

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7", "#56B4E9", "#8C6D31")
"""Okabe & Ito's, told apart with any colour vision; a brown in place of its black, which is the
truth's."""
MAX_NAMED = len(PALETTE)
"""Hypotheses with a colour and an entry in the legend; the others are thin, grey and counted."""
LIMB_COLOURS = {
    "head": "#555555",
    "right arm": "#762A83",
    "right leg": "#B088BD",
    "left arm": "#1B7837",
    "left leg": "#73B87A",
}
"""Purple right, green left; arms dark, legs light."""
TORSO_COLOUR, OTHER_COLOUR, DRAW_COLOUR = "#555555", "#9A9A9A", "#8A8A8A"
SEGMENTS = tuple((PARENTS[joint], joint) for joint in range(1, NUM_JOINTS))
LIMB_OF = {
    bone.end: limb.name for limbs in GROUPS.values() for limb in limbs for bone in limb.bones
}
"""The limb of each joint that moves."""
LEFT_LIMBS = {joint for joint, limb in LIMB_OF.items() if limb.startswith("left")}
COLOURS = [
    LIMB_COLOURS[LIMB_OF[joint]] if joint in LIMB_OF else TORSO_COLOUR
    for joint in range(NUM_JOINTS)
]
"""By joint."""


_ARMS = ("elbow", "wrist", "shoulder", "arm", "hand", "reach")


def measure_colour(name: str) -> str:
    """Of the limb that the name of a measure begins to speak of; the torso's where it has no
    side."""
    sides = [side for side in ("right", "left") if side in name]
    if not sides:
        return TORSO_COLOUR
    limb = "arm" if any(word in name for word in _ARMS) else "leg"
    return LIMB_COLOURS[f"{min(sides, key=name.find)} {limb}"]


def hypothesis_colours(number: int) -> list[str]:
    """Colours of that many hypotheses, heaviest first; beyond the palette they share a grey."""
    return [*PALETTE, *[OTHER_COLOUR] * number][:number]
