"""Random scenes that name whatever a scene can name, as dicts, and random ways to write a dict as TOML, without the package."""

from __future__ import annotations

import json
import math
import random
from collections.abc import Callable
from typing import Any

Section = dict[str, Any]

#: Models whose tissue tools stick to: they know no needles, no jaws and no springs.
STICKING = [
    "energy-balance-neo-hookean",
    "energy-balance-stvk",
    "chainmail-classical",
    "chainmail-ellipsoid",
    "shape-matching",
]


class Draw:
    """A scene by its number, and the poses that a hand takes in it."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.scene: Section = {"name": f'drawn "{seed}" \u00e4\t\\'}
        family = self.random.choice([self._pressed, self._pressed, self._lifted, self._sewn, self._shafts])
        #: Positions of the driven grip [m], in turn.
        self.positions_m: list[list[float]] = family()
        self._frame()

    def near(self, low: float, high: float) -> float:
        return self.random.uniform(low, high)

    def chance(self, part: float) -> bool:
        return self.random.random() < part

    def optional(self, section: Section, part: float = 0.5, **keys: Callable[[], Any]) -> Section:
        """Adds each key with a chance of `part`."""
        for key, value in keys.items():
            if self.chance(part):
                section[key] = value()
        return section

    def vector(self, size: float) -> list[float]:
        return [self.near(-size, size) for _ in range(3)]

    def direction(self, x: float, y: float, z: float) -> list[float]:
        """About along this one, of any length."""
        length = self.near(0.5, 2.0)
        return [length * (each + self.near(-0.05, 0.05)) for each in (x, y, z)]

    def _frame(self) -> None:
        """What every scene may have."""
        draw, scene = self.random, self.scene
        scene["seconds"] = draw.randint(1, 9)
        if {"needle", "jaws", "tissue_contact"} & set(scene):
            self.optional(scene, solve_at_s=lambda: self.near(0.1, 0.9))
        self.optional(
            scene,
            device=lambda: draw.choice(["cartesian-bench", "devices/serial-arm.toml"]),
            host=lambda: self.optional(
                {}, host_hz=lambda: float(draw.choice([50, 100, 200])), horizon_ms=lambda: self.near(50.0, 90.0)
            ),
        )
        if "device" not in scene:
            return
        self.optional(
            scene,
            hand=lambda: {
                "stiffness_n_per_m": self.near(300.0, 1000.0),
                "damping_n_s_per_m": self.near(3.0, 10.0),
                "way_point": [
                    {"time_s": 0.5 * number, "position_m": position_m}
                    for number, position_m in enumerate(self.positions_m)
                ],
            },
        )

    def _slab(self) -> Section:
        draw = self.random
        size_m = [self.near(0.05, 0.08), self.near(0.05, 0.08), self.near(0.02, 0.04)]
        return {"size_m": size_m, "divisions": [draw.randint(3, 5), draw.randint(3, 5), 2]}

    def _tube(self) -> Section:
        inner = self.near(0.008, 0.012)
        return {
            "radii_m": [inner, inner + self.near(0.004, 0.008)],
            "length_m": self.near(0.02, 0.04),
            "divisions": [1, self.random.randint(8, 10), 3],
        }

    def _body(self) -> float:
        """A slab, a slab with another part beside it, or a cube from a file; how high its top is [m]."""
        scene, kind = self.scene, self.random.choice(["slab", "parts", "file"])
        if kind == "slab":
            slab = self._slab()
            scene["mesh"] = {"slab": slab}
            scene["fixed"] = [{"plane": {"axis": "z", "at_m": -slab["size_m"][2]}}]
            return 0.0
        if kind == "file":
            scale = self.near(0.05, 0.08)
            scene["mesh"] = {"file": "tests/data/cube_350.msh", "scale_to_m": scale}
            scene["fixed"] = [{"plane": {"axis": "z", "at_m": 0.0, "within_m": 1e-5}}]
            return scale
        slab, tube = self._slab(), self._tube()
        axis = self.random.choice(["x", "y", "z"])
        beside = {"name": "beside", "tube": tube | {"axis": axis}, "at_m": [0.1, self.near(-0.01, 0.01), 0.0]}
        height_m = self.near(-0.005, 0.005)
        scene["mesh"] = {"part": [{"name": "slab", "slab": slab, "at_m": [0.0, 0.0, height_m]}, beside]}
        low = height_m - slab["size_m"][2]
        scene["fixed"] = [
            {"box": {"min_m": [-0.05, -0.05, low - 1e-6], "max_m": [0.05, 0.05, low + 1e-6]}},
            {"box": {"min_m": [0.07, -0.1, -0.1], "max_m": [0.1, 0.1, 0.1]}},
        ]
        return height_m

    def _material(self, section: Section) -> Section:
        section["youngs_modulus_pa"] = 10 ** self.near(3.5, 5.0)
        section["poisson_ratio"] = self.near(0.0, 0.48)
        return section

    def _tissue(self, models: list[str]) -> str:
        draw, scene = self.random, self.scene
        model = draw.choice(models)
        tissue = self._material({"model": model})
        if model == "linear" and self.chance(0.5):
            del tissue["model"]
        if model == "corotational":
            self.optional(
                tissue,
                corotational=lambda: self.optional(
                    {},
                    refactor_rotation_deg=lambda: self.near(1.0, 20.0),
                    refactor_every=lambda: draw.randint(1, 20),
                    cg_iterations=lambda: draw.randint(2, 20),
                    passes=lambda: draw.randint(3, 10),
                    tolerance=lambda: 10 ** self.near(-6.0, -3.0),
                ),
            )
        if model == "hyperelastic" and self.chance(0.3):
            tissue["setting"] = "averaged cells, to 1e-3"
        if model == "energy-balance-neo-hookean" and self.chance(0.5):
            tissue["relaxation"] = {"share": self.near(0.1, 0.9), "time_s": self.near(0.05, 5.0)}
        scene["tissue"] = tissue
        return model

    def _regions(self) -> None:
        """A stiffer part, by a box or by its name; weight, on all of it."""
        scene, parts = self.scene, self.scene["mesh"].get("part")
        # A classical ChainMail has one material.
        if scene["tissue"].get("model") != "chainmail-classical" and self.chance(0.5):
            middle_m = 0.5 * scene["mesh"].get("scale_to_m", 0.0)
            region: Section = {"box": {"min_m": [-1, -1, -1], "max_m": [middle_m + self.near(0.0, 0.01), 1.0, 1.0]}}
            if parts and self.chance(0.5):
                region = {"tag": self.random.choice([1, parts[0]["name"]])}
            scene["region"] = [self._material(region)]
        if self.chance(0.4):
            scene["tissue"]["density_kg_per_m3"] = self.near(900.0, 1100.0)
            for region in scene.get("region", []):
                self.optional(region, density_kg_per_m3=lambda: self.near(900.0, 1500.0))
            scene["gravity_m_per_s2"] = self.vector(5.0)
            self.optional(scene, settle=lambda: True)

    def _friction(self, tool: Section) -> Section:
        self.optional(tool, friction=lambda: self.near(0.0, 0.5))
        if "friction" in tool:
            self.optional(tool, static_friction=lambda: tool["friction"] + self.near(0.0, 0.2))
        return tool

    def _shape(self) -> Section:
        """A tool that touches, looking down; its front is at most 15 mm below its grip."""
        draw = self.random
        shape = draw.choice(["sphere", "flat-punch", "capsule", "rounded-box", "mesh"])
        tool: Section = {"shape": shape}
        if shape == "sphere" and self.chance(0.5):
            del tool["shape"]
        if shape in ("sphere", "flat-punch", "capsule"):
            tool["radius_m"] = self.near(0.011, 0.015)
        if shape == "rounded-box":
            tool["size_m"] = [self.near(0.02, 0.03) for _ in range(3)]
        if shape == "mesh":
            tool |= {"mesh": "tests/data/ring.stl", "scale_to_m": 0.001}
            self.optional(tool, fillet_m=lambda: self.near(0.001, 0.002))
        if shape in ("flat-punch", "rounded-box"):
            self.optional(tool, fillet_m=lambda: self.near(0.002, 0.004))
        if shape in ("flat-punch", "capsule"):
            self.optional(tool, length_m=lambda: self.near(0.02, 0.05))
        if shape != "sphere":
            self.optional(tool, axis=lambda: self.direction(0.0, 0.0, -1.0))
        if shape in ("rounded-box", "mesh"):
            self.optional(tool, side=lambda: self.direction(1.0, 0.0, 0.0))
        return self._friction(self.optional(tool, 0.3, offset_m=lambda: self.vector(0.001)))

    def _way(self, position_m: list[float]) -> list[Section]:
        """Way points of a tool that stays near a place."""
        count = self.random.randint(1, 3)
        points = [{"time_s": 0.3 * number, "position_m": list(position_m)} for number in range(count)]
        for point in points:
            self.optional(point, rotation_deg=lambda: self.vector(3.0))
        return points

    def _others(self, top_m: float) -> list[Section]:
        """Tools beside the driven one, above the tissue."""
        tools = []
        for _ in range(self.random.randint(0, 2)):
            tool = self._shape()
            place_m = [self.near(-0.02, 0.02), self.near(-0.02, 0.02), top_m + self.near(0.02, 0.05)]
            if self.chance(0.5):
                tool["position_m"] = place_m
                self.optional(tool, orientation=lambda: [0.0, 0.0, 0.6, 0.8])
            else:
                tool["way_point"] = self._way(place_m)
            tools.append(tool)
        return tools

    def _pressed(self) -> list[list[float]]:
        """Tools press on tissue of any model."""
        top_m = self._body()
        model = self._tissue(["linear", "corotational", "hyperelastic", *STICKING])
        self._regions()
        driven = self._shape()
        if self.chance(0.5):
            driven["driven"] = True
        if self.chance(0.3):
            driven["way_point"] = [{"time_s": 0.0}, {"time_s": 0.5, "rotation_deg": self.vector(5.0)}]
        others = self._others(top_m)
        self.scene["tool"] = [driven, *others]
        if "driven" in driven and others and self.chance(0.5):
            # The driven one need not be the first.
            others[0]["driven"] = False
            self.scene["tool"] = [others[0] | {"id": 7}, driven, *others[1:]]
        if model not in STICKING:
            self._pulled(top_m)
        else:
            for tool in self.scene["tool"]:
                tool.pop("friction", None), tool.pop("static_friction", None)
        if "settle" in self.scene and not others and "handle" not in self.scene:
            # Where nothing is brought to it the tissue may begin as the mesh has it.
            self.scene["settle"] = self.chance(0.5)
        x_m = 0.5 * self.scene["mesh"]["scale_to_m"] if "file" in self.scene["mesh"] else 0.001
        reach_m = driven.get("radius_m", 0.0) if driven.get("shape", "sphere") in ("sphere", "capsule") else 0.0
        return [[x_m, x_m, top_m + reach_m + height_m] for height_m in (0.01, -0.001, -0.002)]

    def _pulled(self, top_m: float) -> None:
        """Springs and loads."""
        scene = self.scene
        middle_m = 0.5 * scene["mesh"].get("scale_to_m", 0.0)
        if self.chance(0.3):
            springs: list[Section] = [
                {"from_m": [middle_m - 0.01, middle_m, top_m], "to_m": [middle_m + 0.01, middle_m, top_m], "stiffness_n_per_m": self.near(10.0, 60.0)},
                {
                    "from_m": [middle_m + 0.01, middle_m + 0.01, top_m],
                    "to_m": [middle_m + 0.01, middle_m + 0.01, top_m + 0.03],
                    "to_is_fixed": True,
                    "stiffness_n_per_m": self.near(10.0, 40.0),
                },
            ]
            scene["spring"] = [self.optional(spring, length_m=lambda: self.near(0.025, 0.035)) for spring in springs]
        if self.chance(0.2):
            on: Section = {"nodes": [self.random.randrange(0, 30)]} if self.chance(0.5) else self.scene["fixed"][0]
            scene["load"] = [{"on": on, "total_force_n": self.vector(0.01)}]
        slab = scene["mesh"].get("slab")
        if slab and self.chance(0.4):
            # The last node is a corner of the top.
            corner = math.prod(count + 1 for count in slab["divisions"]) - 1
            handle: Section = {"vertices": [corner], "barycentric": [1.0], "target_displacement_m": self.vector(0.001)}
            scene["handle"] = [self.optional(handle, name=lambda: "corner")]

    def _lifted(self) -> list[list[float]]:
        """Jaws take hold of a slab's top."""
        draw, slab = self.random, self._slab()
        self.scene["mesh"] = {"slab": slab}
        self.scene["fixed"] = [{"plane": {"axis": "z", "at_m": -slab["size_m"][2]}}]
        self._tissue(["linear", "corotational", "hyperelastic"])
        self._regions()
        self.scene["tool"] = [{"shape": "grip", "id": draw.randint(0, 200)}]
        jaws: Section = {
            "tool": self.scene["tool"][0]["id"],
            "clamp_n": draw.choice([float("inf"), self.near(1.0, 5.0)]),
            "friction": self.near(0.2, 0.6),
            "close": [self.optional({"from_s": 0.0}, to_s=lambda: self.near(1.0, 2.0))],
        }
        self.optional(
            jaws,
            length_m=lambda: self.near(0.015, 0.025),
            width_m=lambda: self.near(0.005, 0.01),
            opening_deg=lambda: self.near(40.0, 80.0),
            offset_m=lambda: self.vector(0.001),
            axis=lambda: self.direction(0.0, 0.0, -1.0),
            side=lambda: self.direction(1.0, 0.0, 0.0),
            points=lambda: draw.randint(3, 8),
            strength_pa=lambda: 10 ** self.near(4.0, 6.0),
        )
        self.scene["jaws"] = [jaws]
        return [[0.001, 0.002, height_m] for height_m in (-0.004, -0.003, -0.001)]

    def _needle_tissue(self) -> Section:
        section: Section = {
            "friction_n_per_m": self.near(0.0, 30.0),
            "puncture_pa": self.random.choice([self.near(1e5, 5e5), float("inf")]),
        }
        return self.optional(
            section,
            static_friction_n_per_m=lambda: section["friction_n_per_m"] + self.near(0.0, 10.0),
            viscous_n_s_per_m2=lambda: self.near(0.0, 100.0),
            cutting_pa=lambda: self.near(0.0, 1e5),
            surface_friction=lambda: self.near(0.1, 1.0),
        )

    def _needle(self, over_m: list[float]) -> Section:
        """A needle that goes down from a place."""
        shape = self.random.choice(["straight", "arc", "segments"])
        needle: Section = {"shape": shape, "thickness_m": self.near(0.0004, 0.0008), "end_m": over_m}
        needle["direction"] = [self.near(0.5, 2.0) * each for each in (0.01, 0.02, -1.0)]
        if shape == "straight":
            needle["length_m"] = self.near(0.02, 0.03)
        if shape == "arc":
            needle |= {"radius_m": self.near(0.02, 0.03), "angle_deg": self.near(30.0, 60.0)}
        if shape == "segments":
            straight, bent = {"length_m": self.near(0.01, 0.015)}, {"length_m": 0.01, "radius_m": self.near(0.02, 0.03)}
            needle["segments"] = self.random.choice([[straight, bent], [bent, straight], [straight]])
        if shape != "straight":
            needle["towards"] = self.direction(1.0, 0.0, 0.0)
        return self.optional(needle, 0.3, body=lambda: True)

    def _sewn(self) -> list[list[float]]:
        """Two parts, and a needle with a thread that goes into one."""
        draw, scene = self.random, self.scene
        size_m = [0.02, 0.03, self.near(0.008, 0.012)]
        gap_m = self.near(0.003, 0.005)
        middle_m = 0.5 * (gap_m + size_m[0])
        slab = {"size_m": size_m, "divisions": [4, 6, 2]}
        scene["mesh"] = {
            "part": [
                {"name": "left", "slab": slab, "at_m": [-middle_m, 0.0, 0.0]},
                {"name": "right", "slab": slab, "at_m": [middle_m, 0.0, 0.0]},
            ]
        }
        far_m = middle_m + 0.01
        scene["fixed"] = [{"plane": {"axis": "x", "at_m": at_m, "within_m": 1e-5}} for at_m in (-far_m, far_m)]
        self._tissue(["linear", "corotational", "hyperelastic"])
        scene["tissue"]["youngs_modulus_pa"] = self.near(20e3, 60e3)
        scene["tissue"]["needle"] = self._needle_tissue()
        self._regions()
        for region in scene.get("region", []):
            self.optional(region, needle=self._needle_tissue)
        x_m, y_m = -middle_m + self.near(-0.003, 0.003), self.near(-0.003, 0.003)
        start_m = [x_m, y_m, 0.035]
        needle = self._needle(start_m)
        aside_m = [0.02, 0.01, 0.03]
        driven: Section = {"id": 0, "shape": "grip"}
        second: Section = self.optional({"id": 1, "shape": "grip", "position_m": aside_m}, reach_m=lambda: 0.01)
        scene["tool"] = [driven, second]
        needle["hold"] = [{"time_s": 0.0, "tool": 0}]
        if self.chance(0.5):
            needle["hold"] += [{"time_s": 0.5, "tool": 1}, {"time_s": 0.8}]
        scene["needle"] = [self.optional(needle, id=lambda: 0)]
        if self.chance(0.8):
            self._thread(aside_m)
        if self.chance(0.5):
            contact: Section = {"between": draw.choice([["left", "right"], [1, 2]])}
            rims = [
                {"box": {"min_m": [low_m - 1e-6, -1, -1], "max_m": [low_m + 1e-6, 1, 1]}}
                for low_m in (-0.5 * gap_m, 0.5 * gap_m)
            ]
            self.optional(contact, friction=lambda: self.near(0.0, 0.3), rims=lambda: rims)
            scene["tissue_contact"] = [contact]
        self.optional(scene, needle_solver=lambda: self.optional({}, playback=lambda: draw.choice(["one-solve", "every-pose"])))
        return [[x_m, y_m, height_m] for height_m in (0.035, 0.033, 0.0315)]

    def _thread(self, aside_m: list[float]) -> None:
        draw = self.random
        thread: Section = {"needle": 0, "length_m": self.near(0.2, 0.4)}
        tail = draw.choice([{"knot": True}, {"tool": 1}, {"at_m": [0.03, 0.0, 0.03]}])
        thread["hold"] = [{"time_s": 0.0, "end": "tail"} | tail]
        if self.chance(0.5):
            span = {"time_s": 0.6, "end": draw.choice(["span", "head"]), "tool": 1}
            thread["hold"] += [span, span | {"time_s": 0.7, "lets_go": True}]
        self.optional(
            thread,
            id=lambda: 3,
            friction=lambda: self.near(0.0, 0.3),
            strength_n=lambda: self.near(5.0, 60.0),
            axial_stiffness_n=lambda: draw.choice([float("inf"), self.near(50.0, 500.0)]),
            drag_n_per_m=lambda: self.near(0.0, 20.0),
            grip_n=lambda: self.near(0.5, 5.0),
            knot_n=lambda: self.near(0.5, 5.0),
            thickness_m=lambda: self.near(1e-4, 4e-4),
            tear_pa=lambda: self.near(1e5, 1e6),
            body=lambda: True,
            cut=lambda: [
                self.optional({"time_s": 0.9} | draw.choice([{"tool": 1}, {"at_m": aside_m}]), knots=lambda: True)
            ],
        )
        tighten: Section = {"time_s": 0.75, "until_s": self.near(0.8, 1.0), "ratio": self.near(0.1, 0.9)}
        self.optional(tighten, in_turn=lambda: True, most_n=lambda: self.near(0.2, 2.0))
        self.optional(thread, 0.3, tighten=lambda: [tighten])
        self.scene["thread"] = [thread]
        if self.chance(0.3):
            self.scene["tool"][1]["body"] = self._bar([0.0, 1.0, 0.0])
            self.scene["body_contact"] = [{"between": [{"thread": thread.get("id", 0)}, {"tool": 1}]}]

    def _bar(self, axis: list[float]) -> Section:
        bar: Section = {"radius_m": self.near(0.001, 0.003), "length_m": self.near(0.03, 0.06)}
        return self.optional(
            bar,
            axis=lambda: self.direction(*axis),
            offset_m=lambda: [0.5 * bar["length_m"] * each for each in axis],
            friction=lambda: self.near(0.0, 0.3),
        )

    def _shafts(self) -> list[list[float]]:
        """Shafts of instruments, one on the other, over a slab."""
        slab = self._slab()
        self.scene["mesh"] = {"slab": slab}
        self.scene["fixed"] = [{"plane": {"axis": "z", "at_m": -slab["size_m"][2]}}]
        self._tissue(["linear", "corotational", "hyperelastic"])
        self._regions()
        crossing = {"radius_m": 0.002, "length_m": 0.06}
        self.scene["tool"] = [
            {"shape": "grip", "body": self.optional(dict(crossing), friction=lambda: self.near(0.0, 0.3))},
            {"shape": "grip", "body": crossing | {"axis": [1.0, 0.0, 0.0], "offset_m": [0.03, 0.0, 0.0]}},
        ]
        self.scene["tool"][0]["body"] |= {"axis": [0.0, 1.0, 0.0], "offset_m": [0.0, 0.03, 0.0]}
        self.scene["tool"][1]["position_m"] = [0.0, 0.0, self.near(0.010, 0.012)]
        contact: Section = {"between": [{"tool": 0}, {"tool": 1}]}
        self.optional(contact, stiffness_n_per_m=lambda: self.near(300.0, 1000.0), friction=lambda: self.near(0.0, 0.3))
        self.scene["body_contact"] = [contact]
        return [[0.002, 0.004, height_m] for height_m in (0.022, 0.0145, 0.014)]


def keys(value: Any) -> set[str]:
    """All keys of a description, and of what is in it."""
    if isinstance(value, dict):
        return set(value).union(*map(keys, value.values()))
    return set().union(*map(keys, value)) if isinstance(value, list) else set()


def toml(description: Section, seed: int) -> str:
    """A text of a description: sections, tables in a line, dotted keys and numbers in any way that the format has."""
    return "\n".join(_Writer(random.Random(seed)).table(description, "")) + "\n"


class _Writer:
    def __init__(self, draw: random.Random) -> None:
        self.draw = draw

    def table(self, table: Section, place: str) -> list[str]:
        """Lines in place first, then sections."""
        here, below = [], []
        for key, value in table.items():
            at = f"{place}.{key}" if place else key
            is_list = isinstance(value, list) and bool(value) and all(isinstance(each, dict) for each in value)
            if isinstance(value, dict) and value and self.draw.random() < 0.6:
                below += [f"[{at}]", *self.table(value, at)]
            elif isinstance(value, dict) and value and self.draw.random() < 0.3:
                here += [f"{key}.{inner} = {self.value(each)}" for inner, each in value.items()]
            elif is_list and self.draw.random() < 0.6:
                for each in value:
                    below += [f"[[{at}]]", *self.table(each, at)]
            else:
                line = f"{self.key(key)} = {self.value(value)}"
                here.append(self.draw.choice([line, f"{line}  # {key}"]))
        return here + below

    def key(self, key: str) -> str:
        return self.draw.choice([key, f'"{key}"', f"'{key}'"])

    def value(self, value: Any) -> str:
        if isinstance(value, bool):
            return "true" if value else "false"
        if isinstance(value, int):
            return self.draw.choice([f"+{value}", f"{value:#x}", str(value)]) if value >= 0 else str(value)
        if isinstance(value, float):
            ways = [repr(value), f"{value:.16e}", f"{value:.17E}"]
            return self.draw.choice(ways) if math.isfinite(value) else self.draw.choice(["inf", "+inf"])
        if isinstance(value, str):
            return json.dumps(value, ensure_ascii=self.draw.random() < 0.5)
        if isinstance(value, list):
            # A list may go over lines.
            end = self.draw.choice(["", "\n"])
            return f"[{end}" + f",{end} ".join(map(self.value, value)) + f"{end}]"
        return "{ " + ", ".join(f"{self.key(key)} = {self.value(each)}" for key, each in value.items()) + " }"
