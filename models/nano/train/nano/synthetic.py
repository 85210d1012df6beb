"""A STAND-IN dataset in the contract's format: simple drawn roads, rule-made answers.

It proves the pipeline (CI, throughput) where the real dataset of `planagent dataset` is not at hand. Nothing trained on it
ships: its roads are cartoons, its labels are rules, not search.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from .occupancy import CELLS, TIMES, hexadecimal

PIXELS = 128
#: Meters per pixel of a 64 m view.
SCALE = 0.5
#: The ego's place: three quarters down, heading up.
EGO = (64.0, 96.0)
LANE = 3.5 / SCALE
#: Drawn larger and made smaller again for smooth edges.
OVERSAMPLE = 2
#: Of so many states, the first two are twins.
TWINS_EVERY = 8

SYSTEM, ASK_SCENE, ASK_MOTION, ASK_CODE = "drive", "scene?", "motion?", "code?"
NODES = ("ego", "front", "front_left", "front_right", "left", "right", "rear", "rear_left", "rear_right")

BACKGROUND, ROAD, LINE, CROSSWALK = (245, 245, 245), (205, 205, 205), (120, 120, 120), (255, 200, 60)
EGO_COLOUR, VEHICLE, PEDESTRIAN, ARROW = (30, 160, 60), (50, 90, 220), (230, 90, 200), (220, 20, 20)


@dataclass(frozen=True)
class Scene:
    """What is drawn and asked."""

    shape: str
    lanes: int
    lane: int
    crosswalk: str
    lead: str
    lead_speed: str
    left: str
    pedestrian: str
    light: str
    limit: int
    speed: int


def draw_scene(rng: np.random.Generator) -> Scene:
    """A random scene whose parts are independent, so that none can be guessed from another."""
    lanes = int(rng.integers(1, 5))
    lead = str(rng.choice(["none", "near", "mid", "far"]))
    lane = int(rng.integers(1, lanes + 1))
    return Scene(
        shape=str(rng.choice(["straight", "curve_left", "curve_right", "intersection"])),
        lanes=lanes,
        lane=lane,
        crosswalk=str(rng.choice(["none", "near", "far"])),
        lead=lead,
        lead_speed="none" if lead == "none" else str(rng.choice(["stopped", "slow", "fast"])),
        left=str(rng.choice(["free", "occupied"])) if lane > 1 else "none",
        pedestrian=str(rng.choice(["none", "ahead"])),
        light=str(rng.choice(["none", "green", "red"])),
        limit=int(rng.choice([8, 11, 14, 20])),
        speed=int(rng.integers(0, 20)),
    )


def twin(scene: Scene, second: bool) -> Scene:
    """A pair that the text does not tell apart: a free road, and a standing vehicle with room beside it."""
    scene = replace(scene, light="none", limit=20, speed=min(scene.speed, 15), lanes=max(scene.lanes, 2), lane=max(scene.lane, 2), pedestrian="none")
    return replace(scene, lead="near" if second else "none", lead_speed="stopped" if second else "none", left="free")


def paint(scene: Scene, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """The scene's image, uint8 (128, 128, 3), and where its objects are now, in one and in two seconds, (3, 16, 16)."""
    k = OVERSAMPLE
    grids = np.zeros((TIMES, CELLS, CELLS), bool)
    picture = Image.new("RGB", (PIXELS * k, PIXELS * k), BACKGROUND)
    pen = ImageDraw.Draw(picture)
    bend = {"curve_left": -1.0, "curve_right": 1.0}.get(scene.shape, 0.0) * rng.uniform(0.003, 0.006)

    def at(lateral: float, ahead: float) -> tuple[float, float]:
        return ((EGO[0] + lateral + bend * max(ahead, 0.0) ** 2) * k, (EGO[1] - ahead) * k)

    def along(lateral: float) -> list[tuple[float, float]]:
        return [at(lateral, ahead) for ahead in np.arange(-36.0, 100.0, 4.0)]

    def box(lateral: float, ahead: float, width: float, length: float, colour: tuple[int, int, int]) -> None:
        x, y = at(lateral, ahead)
        pen.rectangle([x - width * k / 2, y - length * k / 2, x + width * k / 2, y + length * k / 2], fill=colour)

    def occupy(lateral: float, ahead: float, width: float, length: float, speed: float = 0.0) -> None:
        for time in range(TIMES):
            x, y = (place / k for place in at(lateral, ahead + speed * time))
            cells = (slice(max(0, int(low * CELLS / PIXELS)), max(0, int(high * CELLS / PIXELS) + 1)) for low, high in spans(x, y, width, length))
            grids[time][tuple(cells)] = True

    left_edge = -(scene.lane - 0.5) * LANE
    right_edge = left_edge + scene.lanes * LANE
    pen.polygon(along(left_edge) + along(right_edge)[::-1], fill=ROAD)
    if scene.shape == "intersection":
        y = EGO[1] - rng.uniform(50, 70)
        pen.rectangle([0, (y - 12) * k, PIXELS * k, (y + 12) * k], fill=ROAD)
    for i in range(scene.lanes + 1):
        pen.line(along(left_edge + i * LANE), fill=LINE, width=k)
    if scene.crosswalk != "none":
        ahead = rng.uniform(14, 24) if scene.crosswalk == "near" else rng.uniform(38, 48)
        pen.polygon(
            [at(left_edge, ahead - 3), at(right_edge, ahead - 3), at(right_edge, ahead + 3), at(left_edge, ahead + 3)],
            fill=CROSSWALK,
        )
    if scene.lead != "none":
        low, high = {"near": (16, 26), "mid": (36, 48), "far": (62, 76)}[scene.lead]
        ahead = rng.uniform(low, high)
        box(0.0, ahead, 4, 9, VEHICLE)
        reach = {"stopped": 0.0, "slow": 7.0, "fast": 16.0}[scene.lead_speed]
        pen.line([at(0.0, ahead), at(0.0, ahead + reach)], fill=ARROW, width=2 * k)
        occupy(0.0, ahead, 4, 9, reach)
    if scene.left == "occupied":
        place = (-LANE, rng.uniform(-12, 6), 4, 9)
        box(*place, VEHICLE)
        occupy(*place)
    if scene.pedestrian == "ahead" or rng.random() < 0.5:
        beside = scene.pedestrian != "ahead"
        place = (right_edge + rng.uniform(6, 16), rng.uniform(10, 60), 3, 3) if beside else (rng.uniform(-2, 2), rng.uniform(10, 28), 3, 3)
        box(*place, PEDESTRIAN)
        occupy(*place)
    box(0.0, 0.0, 4, 9, EGO_COLOUR)
    return np.asarray(picture.resize((PIXELS, PIXELS), Image.Resampling.BOX)), grids


def spans(x: float, y: float, width: float, length: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Pixels down and across of a box, a little inside."""
    return (y - length / 2 + 2, y + length / 2 - 2), (x - width / 2 + 1, x + width / 2 - 1)


def text(scene: Scene, rng: np.random.Generator) -> str:
    """The stand-in's scene text in the manner of the compact prompts: words at fixed places; light and limit are not in the image."""
    light = f"{scene.light} {rng.integers(5, 60)}" if scene.light != "none" else "none -"
    parts = [f"speed {scene.speed} limit {scene.limit} light {light} turn {rng.choice(['left', 'right', 'straight'])}"]
    for node in NODES:
        if "left" in node and scene.lane == 1 or "right" in node and scene.lane == scene.lanes:
            parts.append(f"{node} none - -")
        elif rng.random() < 0.7:
            parts.append(f"{node} free - -")
        else:
            parts.append(f"{node} vehicle{rng.integers(1, 9)} {rng.integers(0, 60)} {rng.integers(0, 20)}")
    return " ".join(parts) + f" rest {rng.integers(0, 12)}"


def marked(template: str, values: dict[str, str]) -> dict:
    """An answer with its learned spans: `{name}` in the template is replaced and marked."""
    content, learn, last = "", [], 0
    for match in re.finditer(r"\{(\w+)\}", template):
        content += template[last : match.start()]
        value = values[match.group(1)]
        learn.append([len(content), len(content) + len(value)])
        content += value
        last = match.end()
    return {"role": "assistant", "content": content + template[last:], "learn": learn}


def conversation(scene: Scene, rng: np.random.Generator) -> list[dict]:
    """Three rounds: facts, instruction, code."""
    facts = {
        "scene": scene.shape, "light": scene.light, "limit": str(scene.limit), "lanes": str(scene.lanes), "lane": str(scene.lane),
        "crosswalk": scene.crosswalk, "lead": scene.lead, "leadspeed": scene.lead_speed, "left": scene.left, "ped": scene.pedestrian,
    }  # fmt: skip
    slow_lead = scene.lead in ("near", "mid") and scene.lead_speed in ("stopped", "slow")
    if scene.light == "red":
        motion = ("stop", "red_light")
    elif scene.pedestrian == "ahead":
        motion = ("stop", "pedestrian")
    elif slow_lead and scene.left != "free":
        motion = ("decelerate", "lead")
    else:
        motion = ("accelerate", "free_road") if scene.speed + 2 < scene.limit else ("keep", "none")
    change = slow_lead and scene.left == "free" and motion[0] != "stop"
    lateral = ("left", "slow_lead") if change else ("keep", "none")
    target = {"stop": 0, "decelerate": scene.limit // 2}.get(motion[0], scene.limit)
    code = {
        "c": "left_lane" if change else "ego_lane", "la": "none" if scene.lead == "none" or change else "vehicle1",
        "v0": str(target), "acc": "2.0" if motion[0] == "accelerate" else "1.0", "dec": "3.0" if motion[0] == "stop" else "1.5",
    }  # fmt: skip
    motion_facts = {"lon": motion[0], "why": motion[1], "lat": lateral[0], "what": lateral[1]}
    return [
        {"role": "system", "content": SYSTEM},
        {"role": "user", "content": f"<image>\n{text(scene, rng)}\n{ASK_SCENE}"},
        marked(" ".join(f"{key}={{{key}}}" for key in facts), facts),
        {"role": "user", "content": ASK_MOTION},
        marked("why={what} lat={lat} why={why} lon={lon}", motion_facts),
        {"role": "user", "content": ASK_CODE},
        marked("Generate_IDM_Planner(c={c}, la={la}, v0={v0}, acc={acc}, dec={dec})", code),
    ]


def write(folder: Path, train: int, validation: int, seed: int, shard: int = 1000) -> None:
    """Writes a stand-in dataset folder."""
    folder.mkdir(parents=True, exist_ok=True)
    meta = {"format": 1, "image_pixels": PIXELS, "source": "stand-in scenes, not the simulator's", "seed": seed}
    (folder / "meta.json").write_text(json.dumps(meta, indent=1) + "\n")
    for split, size, offset in (("train", train, 0), ("validation", validation, 1)):
        for index, start in enumerate(range(0, size, shard)):
            count = min(shard, size - start)
            rows, pictures = [], []
            for i in range(count):
                place = i % TWINS_EVERY
                # The twins of a pair have the same draws, so the same text, up to their pictures.
                paired = place < 2 and i - place + 1 < count
                rng = np.random.default_rng((seed, offset, start + i - place if paired else start + i))
                scene = draw_scene(rng)
                if paired:
                    scene = twin(scene, place == 1)
                talk = conversation(scene, rng)
                picture, grids = paint(scene, rng)
                pictures.append(picture)
                row = {"state": f"standin-{split}-{start + i}@0.0", "image": i, "conversation": talk, "facts": {}, "occupancy": hexadecimal(grids)}
                if not paired:
                    # As if at a red light.
                    slower = conversation(replace(scene, light="red"), rng)
                    row["tried"] = [{"chance": c, "value": c, "answers": [t[4], t[6]]} for c, t in ((0.75, talk), (0.25, slower))]
                rows.append(row | ({"twin": f"{split}-{start + i - place}"} if paired else {}))
            base = folder / f"{split}-{index:05}"
            base.with_suffix(".jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
            Image.fromarray(np.concatenate(pictures)).save(base.with_suffix(".png"))
