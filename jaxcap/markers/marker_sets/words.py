"""Labels in plain words, such as `LeftKneeLateral`, `R_ankle_med` and `sacrum`, and markers on plates."""

from .marker_table import MarkerTable

_LATERAL = ("lat", "lateral", "l", "out", "outer", "ext", "externe")
_MEDIAL = ("med", "medial", "m", "in", "inner", "int")
#: joints with a landmark on both sides of them
_JOINTS = {
    "knee": "knee kne kn femoralcondyle femoralepicondyle kneeepicondyle con cond condyle",
    "ankle": "ankle ank an ak malleolus mal malleoli mall",
    "elbow": "elbow elb el cubitus cub humeralepicondyle humepi",
}


def _both_sides() -> dict[str, str]:
    """Build the labels of the two landmarks of a joint: the joint and the side in either order."""
    table = {}
    for joint, names in _JOINTS.items():
        for side, words in (("lateral", _LATERAL), ("medial", _MEDIAL)):
            labels = [
                label for name in names.split() for word in words for label in (name + word, word + name)
            ]
            table[f"{joint}_{side}"] = " ".join(labels)
    table["ankle_lateral"] += " lma"
    table["ankle_medial"] += " mma"
    return table


WORDS = MarkerTable(
    "words",
    sided={
        **_both_sides(),
        "temple": "temple", "ear": "ear tragus", "head_side": "head headside", "head_front_lateral": "fronthead headfront foreheadside",
        "head_back_lateral": "backhead headback rearhead",
        "acromion": "should acromion acromium acr acrom shoulder shldr sho shl", "acromioclavicular": "acj acjoint",
        "shoulder_front": "shoulderfront frontshoulder antshoulder", "shoulder_back": "shoulderback backshoulder postshoulder",
        "clavicle": "clavicle cla", "scapula": "scapula sca", "scapula_inferior_angle": "inferiorangle scapinf",
        "deltoid": "deltoid delt", "olecranon": "olecranon",
        "wrist_radial": "wristradius wristrad wrr radialstyloid styloidradius radialwrist wristradial wristthumb wristlat lwrist latwrist wristlateral wrad",
        "wrist_ulnar": "wristulna wristuln wru ulnarstyloid styloidulna ulnarwrist wristulnar wristpinky wristpinkie wristmed mwrist medwrist wristmedial wuln",
        "wrist_dorsal": "wristtop wrist wri", "hand_2nd_knuckle": "mcp2 2mcp hand2 mc2 2ndmetacarpal secondmetacarpal",
        "hand_3rd_knuckle": "mcp3 3mcp hand3 mc3 3rdmetacarpal", "hand_5th_knuckle": "mcp5 5mcp hand5 mc5 5thmetacarpal fifthmetacarpal",
        "hand_dorsal": "hand handtop handdorsum", "thumb": "thumb",
        "asis": "asis asi sias anteriorsuperioriliacspine", "psis": "psis psi sips posteriorsuperioriliacspine",
        "iliac_crest": "iliaccrest crest iliac ilcrest ilc icr ilcr", "trochanter": "greatertrochanter trochanter troch gtroch gtr gtro grtr gtroc hip grt trc tro",

        "patella": "patella pat middlekneecap kneecap", "tibial_tuberosity": "tibialtuberosity tibtub tuberosity tibt tibialtub ttub ttb",
        "fibula_head": "fibulahead fibhead headfibula fibh", "heel": "heel heelback calcaneus calc calcan hee cal backheel heelpost",
        "heel_high": "heeltop heelup heelhigh heelupper heelsup calcprox heelprox uheel upperheel", "heel_lateral": "heellat latheel heellateral calclat heelout latcalc lcal call",
        "heel_medial": "heelmed medheel heelmedial calcmed heelin medcalc mcal sustentaculum calm", "navicular": "navicular nav",
        "foot_1st_base": "1stmetbase bmt1 mt1base mt1b mb1 p1mt basemt1",
        "foot_2nd_base": "2ndmetbase bmt2 mt2base mt2b mb2 p2mt basemt2 midfoot midfootsup foottop",
        "foot_5th_base": "5thmetbase bmt5 mt5base mt5b mb5 p5mt p5 basemt5 midfootlat styloidmt5 vmb",
        "foot_1st_head": "m1 mt1 mth1 met1 mtp1 1mt 1met 1mth 1mtp mh1 meta1 1stmet firstmetatarsal 1stmetatarsal d1mt d1m metatarsal1 mt1head mt1h 1stmt toemed medtoe toein toem",
        "foot_2nd_head": "mt2 mth2 met2 mtp2 2mt 2met 2mth 2mtp mh2 meta2 2ndmet secondmetatarsal 2ndmetatarsal d2mt metatarsal2 mt2head mt2h mt23 2ndmt toe23",
        "foot_3rd_head": "mt3 mth3 met3 mtp3 3mt 3met mh3 metatarsal3",
        "foot_5th_head": "m5 meta5 mt5 mth5 met5 mtp5 5mt 5met 5mth 5mtp mh5 meta5 5thmet fifthmetatarsal 5thmetatarsal d5mt d5m metatarsal5 mt5head mt5h 5thmt toelat lattoe toeout toel",
        "toe_tip": "toe tipoftoe toetip tiptoe toes", "big_toe": "hallux bigtoe hal hlx toe1 greattoe",
    },
    loose={
        "upper_arm_lateral": "ua uarm upperarm humerus upa bicep", "forearm_lateral": "fa farm forearm frm", "wrist_radial": "radius rad", "wrist_ulnar": "ulna uln",
        "thigh_lateral": "th thi thigh femur", "shank_lateral": "sk shk sha shank tib shin tibia",
    },
    whole={
        "head_top": "tophead headtop vertex hvertex thead", "head_front": "forehead headfront fronthead frontofhead", "head_back": "headback backhead",
        "nose_bridge": "nasion sellion glabella glab", "nose": "nose", "occiput": "occiput", "chin": "chin",
        **{name: f"{name} {name[0]}v{name[1:]} {'th' if name[0] == 't' else name[0]}{name[1:]}" for name in
           ("c7", "t1", "t2", "t3", "t4", "t5", "t6", "t7", "t8", "t9", "t10", "t11", "t12", "l1", "l2", "l3", "l4", "l5")},
        "jugular_notch": "jugularnotch suprasternal sternalnotch incisurajugularis clav manubrium supsternum jn ij jug",
        "sternum": "sternum chest", "xiphoid": "xiphoid xiphoidprocess xyphoid xiph xyph stern strn px", "navel": "navel umbilicus",
        "sacrum": "psis sacrum sacral sacr vsacral sac s1 s2 vsac sacl", "l5": "l5s1 l5 lv5",
        "right scapula": "rback rbak rbac rightback backright", "left scapula": "lback lbak lbac leftback backleft",
    },
)  # fmt: skip

#: stems of labels that end in a number or a letter: markers on a plate or scattered on the segment
PLATES = MarkerTable(
    "plates",
    plates={
        "upper_arm_lateral": "UA UARM UPARM UPPERARM ARM HUM HUMERUS BICEP BRACHIUM UPA UAR UARMCL",
        "forearm_lateral": "FA FARM FOREARM FRM FORE FO LA LARM LOWERARM LOARM FAR ANTEBRACHIUM",
        "hand_dorsal": "HAND HANDCL",
        "thigh_lateral": "TH FM THI THIGH FEM FEMUR THG TG THL THC TC THIGHCL UPPERLEG ULEG QUAD",
        "shank_lateral": "SH SHA SHANK SK TB TIB TIBIA LEG LG SHN SHI SHIN SHC SC CALF LOWERLEG LLEG TL SHNK",
        "foot_2nd_base": "FOOT FT FC",
        "sacrum": "PELVIS PELV PEL PLV PV SAC SACRUM", "t8": "TRUNK THORAX THX TRNK TORSO BACK", "head_top": "HEAD HD HEADCL",
    },
)  # fmt: skip

#: single letters for thigh and shank, where a take has numbered labels with both
LETTER_PAIRS = (("F", "T"), ("T", "S"))
