"""Who is captured: everything about one person, drawn from a seed. Needs numpy only.

A `Subject` depends only on (seed, index), so that any process can make any person again, in any order.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from grmm_core.head import PeopleModel

SHAPE_COUNT = 300
CALM_SHARE = 0.75  # of the residual spread: the far tails of independent coefficients look like nobody
SHAPE_LIMIT = 2.2  # standard deviations
# how often styles are worn, and what tightly coiled hair adds
WOMEN = {
    "long": 3.0, "layered": 1.6, "wavy_long": 1.6, "bob": 1.6, "ringlets": 1.2, "ponytail": 1.4, "bun": 1.0, "fringe": 1.0,
    "curly": 0.9, "pixie": 0.9, "side_part": 0.4, "curtains": 0.5,
}  # fmt: skip
MEN = {
    "crop": 1.6, "fade": 1.4, "side_part": 1.6, "buzz": 1.0, "stubble": 0.6, "slick_back": 0.9, "undercut": 0.7, "quiff": 1.0,
    "curly": 0.9, "fringe": 0.7, "curtains": 0.5, "wavy_long": 0.4, "mohawk": 0.2, "bun": 0.2, "receding": 0.3, "bald": 0.8,
}  # fmt: skip
TIGHT = {"afro": 1.8, "coily": 1.8, "buzz": 1.0, "curly": 0.9, "locs": 1.0, "braids": 1.0, "ringlets": 0.4}


@dataclass(frozen=True)
class Subject:
    """One person of a capture.

    Attributes:
        seed, index: What it was drawn from.
        shape: Head-model shape coefficients, [300].
        macros: Age in years, female, african, asian, caucasian, muscle, weight in 0..1.
        melanin: Skin melanin, 0 (very light) to 2.2 (very dark), optical depth units of `skin_albedo`.
        blood: Haemoglobin, 0.3 to 1.1, likewise.
        redness: Strength of the redder zones (cheeks, nose, ears), 0..1.
        lips: Linear RGB factor on the skin's color, [3].
        pores, freckles, wrinkles, spots, shine: 0..1.
        stubble: Beard shadow density, 0..1.
        beard: Length of the beard's hair in metres; 0 is none.
        beard_cut: "full", "goatee", "moustache", "chinstrap".
        iris: Linear RGB of the iris, [3].
        iris_inner: Linear RGB of the ring around the pupil, [3].
        sclera: Linear RGB of the white, [3].
        iris_angle, pupil_angle: Half angles on the eyeball, radians.
        hair_style: One of `styles.HAIR_STYLES`.
        hair_color: Linear RGB, [3].
        hair_length, hair_curl, hair_volume, hairline, part: Factors around 1 (curl 0..1; hairline metres up; part -1..1).
        brow_thickness, brow_height, brow_arch, brow_density: Factors.
        lash_density: 0.4..1.2.
        teeth: Linear RGB, [3].
        asymmetry: Seed of the small irregular details.
    """

    seed: int
    index: int
    shape: np.ndarray
    macros: dict[str, float]
    melanin: float
    blood: float
    redness: float
    lips: tuple[float, float, float]
    pores: float
    freckles: float
    wrinkles: float
    spots: float
    shine: float
    stubble: float
    beard: float
    beard_cut: str
    iris: tuple[float, float, float]
    iris_inner: tuple[float, float, float]
    sclera: tuple[float, float, float]
    iris_angle: float
    pupil_angle: float
    hair_style: str
    hair_color: tuple[float, float, float]
    hair_length: float
    hair_curl: float
    hair_volume: float
    hairline: float
    part: float
    brow_thickness: float
    brow_height: float
    brow_arch: float
    brow_density: float
    lash_density: float
    teeth: tuple[float, float, float]
    asymmetry: int

    @property
    def female(self) -> bool:
        """Whether hair, lips, lashes and brows are drawn as a woman's."""
        return self.macros["female"] > 0.5

    @property
    def name(self) -> str:
        """Folder and record name of the person."""
        return f"s{self.seed:04d}_{self.index:04d}"

    def to_json(self) -> dict[str, object]:
        """Plain values for a record; the shape goes to the arrays."""
        values = asdict(self)
        del values["shape"]
        return values


def skin_albedo(melanin: float | np.ndarray, blood: float | np.ndarray) -> np.ndarray:
    """Linear RGB albedo of skin by a two-chromophore absorption model, [..., 3].

    Args:
        melanin: Melanin's optical depth, 0..2.2.
        blood: Haemoglobin's optical depth, 0.3..1.1 (more in lips and cheeks).
    """
    base = np.array([0.93, 0.80, 0.71])
    melanin_rgb = np.array([0.80, 1.10, 1.42])
    blood_rgb = np.array([0.06, 0.47, 0.44])
    m = np.asarray(melanin, float)[..., None]
    h = np.asarray(blood, float)[..., None]
    return base * np.exp(-m * melanin_rgb - h * blood_rgb)


def hair_albedo(melanin: float, red: float, grey: float) -> np.ndarray:
    """Linear RGB of hair: melanin 0 (light blond) .. 1 (black), red 0..1, grey 0..1 mixes in white hair."""
    dark = np.exp(-np.array([3.4, 4.1, 5.0]) * melanin) * np.array([0.62, 0.44, 0.235])
    ginger = np.array([0.34, 0.10, 0.025]) * np.exp(-1.6 * melanin)
    color = (1 - red) * dark + red * ginger
    return (1 - grey) * color + grey * np.array([0.46, 0.455, 0.45])


def draw_subject(seed: int, index: int, prior: PeopleModel | None) -> Subject:
    """Draw one person.

    Args:
        seed: Seed of the capture.
        index: Number of the person. Sex, skin and hair walk through all kinds as the index grows, so that small
            captures are varied too.
        prior: Macro statistics of the head model; None draws every coefficient independently.
    """
    g = np.random.default_rng([seed, index, 11])
    walk = np.random.default_rng([seed, 7])
    female = bool((index + int(walk.integers(2))) % 2)
    age = float(np.clip(g.choice([g.uniform(18, 35), g.uniform(30, 55), g.uniform(50, 80)], p=[0.48, 0.32, 0.20]), 18, 80))
    lead = (index // 2 + int(walk.integers(3))) % 3
    races = np.full(3, 0.0)
    races[lead] = 1.0
    races = 0.75 * races + 0.25 * g.dirichlet((0.6, 0.6, 0.6))
    weight = float(np.clip(g.normal(0.5, 0.2), 0.05, 0.98))
    muscle = float(np.clip(g.normal(0.45 if female else 0.56, 0.15), 0.05, 0.95))
    macros = {
        "age": age,
        "female": float(g.uniform(0.85, 1.0) if female else g.uniform(0.0, 0.15)),
        "african": float(races[0]),
        "asian": float(races[1]),
        "caucasian": float(races[2]),
        "muscle": muscle,
        "weight": weight,
    }
    shape = _draw_shape(g, macros, prior)

    african, asian = float(races[0]), float(races[1])
    caucasian = float(races[2])
    melanin = float(
        np.clip(african * g.normal(1.65, 0.35) + asian * g.normal(0.50, 0.22) + caucasian * g.normal(0.22, 0.15), 0.05, 2.25)
    )
    blood = float(np.clip(g.normal(0.50, 0.12), 0.28, 0.85))
    wrinkles = float(np.clip((age - 24) / 50 + g.normal(0, 0.08), 0.02, 1.0))
    lips_tone = g.uniform(0.0, 1.0) if female else g.uniform(0.0, 0.35)  # lipstick or simply redder
    lips = np.array([0.95, 0.70, 0.72]) * (1 - 0.25 * lips_tone * np.array([0.3, 1.0, 0.7]))
    hair_style = _draw_style(g, female, age, african)
    hair_color = _draw_hair_color(g, age, african, asian)
    eye_dark = min(1.0, african * 0.95 + asian * 0.9 + caucasian * float(g.random()) * 1.05)
    kinds = np.array([[0.13, 0.22, 0.34], [0.16, 0.22, 0.13], [0.22, 0.22, 0.21], [0.20, 0.10, 0.035], [0.055, 0.025, 0.012]])
    if eye_dark > 0.62:
        iris = kinds[4] * g.uniform(0.7, 1.6)
    elif eye_dark > 0.42:
        iris = kinds[3] * g.uniform(0.6, 1.2)
    else:
        iris = kinds[int(g.integers(3))] * g.uniform(0.7, 1.3, 3)
    inner = iris * (1.25, 1.05, 0.8) + np.array([0.035, 0.015, 0.0]) * g.random()
    beard_kind = 0.0 if female else float(g.random())
    stubble = 0.0 if female else float(np.clip(g.beta(1.4, 1.6), 0, 1))
    beard, beard_cut = 0.0, str(g.choice(["full", "goatee", "moustache", "chinstrap"], p=[0.6, 0.2, 0.12, 0.08]))
    if beard_kind > 0.52:
        beard = float(g.choice([0.0035, 0.007, 0.012, 0.024, 0.040], p=[0.25, 0.25, 0.25, 0.15, 0.10]))
        stubble = max(stubble, 0.6)
    sclera = (
        np.array([0.70, 0.675, 0.645])
        * g.uniform(0.92, 1.04)
        * np.array([1.0, 1.0 - 0.03 * g.random(), 1.0 - 0.09 * g.random()])
    )
    return Subject(
        seed=seed,
        index=index,
        shape=shape,
        macros=macros,
        melanin=melanin,
        blood=blood,
        redness=float(g.uniform(0.2, 0.9)),
        lips=_triple(lips),
        pores=float(g.uniform(0.2, 1.0)),
        freckles=float(np.clip(g.normal(-0.25, 0.45), 0, 1) * (melanin < 0.45)),
        wrinkles=wrinkles,
        spots=float(np.clip(g.normal(0.1 + 0.3 * (age > 50), 0.2), 0, 1)),
        shine=float(g.uniform(0.2, 0.9)),
        stubble=stubble,
        beard=beard,
        beard_cut=beard_cut,
        iris=_triple(iris),
        iris_inner=_triple(inner),
        sclera=_triple(sclera),
        iris_angle=float(np.radians(g.uniform(22.5, 24.5))),
        pupil_angle=float(np.radians(g.uniform(6.5, 10.0))),
        hair_style=hair_style,
        hair_color=_triple(hair_color),
        hair_length=float(g.uniform(0.75, 1.25)),
        hair_curl=float(np.clip(g.beta(1.2, 3.0) + 0.3 * african, 0, 1)),
        hair_volume=float(g.uniform(0.7, 1.4)),
        hairline=float(g.normal(0.0, 0.004) + (0.004 if age > 45 and not female else 0)),
        part=float(g.choice([-1, 1]) * g.uniform(0.2, 0.8)),
        brow_thickness=float(g.uniform(0.65, 1.0) if female else g.uniform(0.9, 1.4)),
        brow_height=float(g.normal(0, 0.0015)),
        brow_arch=float(g.uniform(0.8, 1.6) if female else g.uniform(0.3, 1.0)),
        brow_density=float(g.uniform(0.6, 1.2)),
        lash_density=float(g.uniform(0.8, 1.3) if female else g.uniform(0.45, 0.8)),
        teeth=_triple(np.array([0.78, 0.74, 0.64]) * g.uniform(0.85, 1.08) * np.array([1, 1, g.uniform(0.85, 1.05)])),
        asymmetry=int(g.integers(1 << 30)),
    )


def _draw_shape(g: np.random.Generator, macros: dict[str, float], prior: PeopleModel | None) -> np.ndarray:
    if prior is None:
        return np.clip(g.normal(0, 0.8, SHAPE_COUNT), -SHAPE_LIMIT, SHAPE_LIMIT).astype(np.float32)
    values = np.array([macros[name] for name in prior.names])
    expected = (values - prior.mean) @ prior.macro_to_shape
    residual = np.clip(g.normal(0, 1, expected.shape), -SHAPE_LIMIT, SHAPE_LIMIT) * CALM_SHARE * prior.residual_std
    return (expected + residual).astype(np.float32)


def _draw_style(g: np.random.Generator, female: bool, age: float, african: float) -> str:
    wear = {name: float(share) for name, share in (WOMEN if female else MEN).items()}
    if age > 42 and not female:
        wear["receding"] += 2.0
        wear["bald"] += 0.9
    if african > 0.5:
        wear = {name: 0.4 * share for name, share in wear.items()}
        for name, share in TIGHT.items():
            wear[name] = wear.get(name, 0.0) + share * (0.2 if female and name == "buzz" else 1.0)
    shares = np.array(list(wear.values()))
    return str(g.choice(list(wear), p=shares / shares.sum()))


def _draw_hair_color(g: np.random.Generator, age: float, african: float, asian: float) -> np.ndarray:
    dark = african + asian > 0.5
    melanin = float(g.uniform(0.72, 1.0) if dark else g.beta(1.3, 1.2))
    red = float(g.random() < 0.14) * float(g.uniform(0.5, 1.0)) * (not dark) + 0.15 * float(g.random())
    if dark and g.random() < 0.12:  # dyed or lightened
        melanin = float(g.uniform(0.35, 0.65))
    grey = float(np.clip((age - 42) / 32 + g.normal(0, 0.2), 0, 1)) if age > 36 else 0.0
    return hair_albedo(melanin, red, grey)


def _triple(values: np.ndarray) -> tuple[float, float, float]:
    r, g, b = (float(v) for v in np.clip(values, 0.0, 1.0))
    return r, g, b
