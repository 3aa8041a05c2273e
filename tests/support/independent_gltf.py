"""A second reading of glTF, sharing nothing with the package: plain recursion over the JSON.

Slow and literal: struct.unpack for each element, 4 x 4 products down the tree, a loop over vertices
for skins. It answers one question, where every triangle of a scene is at a time of an animation.
"""

from __future__ import annotations

import base64
import json
import math
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

FORMATS = {5120: "b", 5121: "B", 5122: "h", 5123: "H", 5125: "I", 5126: "f"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
LARGEST = {5120: 127.0, 5121: 255.0, 5122: 32767.0, 5123: 65535.0}


class IndependentGltf:
    """Reads everything when made; `triangles` poses it."""

    def __init__(self, path: Path) -> None:
        data = path.read_bytes()
        self.blob = b""
        if data[:4] == b"glTF":
            (size,) = struct.unpack_from("<I", data, 12)
            text = data[20:20 + size]
            if len(data) > 20 + size:
                (more,) = struct.unpack_from("<I", data, 20 + size)
                self.blob = data[28 + size:28 + size + more]
        else:
            text = data
        self.g: dict[str, Any] = json.loads(text)
        self.folder = path.parent
        self.buffers = [self._buffer(b) for b in self.g.get("buffers", [])]
        self.cache: dict[int, list[tuple[float, ...]]] = {}

    def _buffer(self, buffer: dict[str, Any]) -> bytes:
        uri = buffer.get("uri")
        if uri is None:
            return self.blob
        if uri.startswith("data:"):
            return base64.b64decode(uri.split(",", 1)[1])
        return (self.folder / unquote(uri)).read_bytes()

    def accessor(self, number: int) -> list[tuple[float, ...]]:
        if number not in self.cache:
            self.cache[number] = self._accessor(number)
        return self.cache[number]

    def _accessor(self, number: int) -> list[tuple[float, ...]]:
        a = self.g["accessors"][number]
        kind, width = a["componentType"], WIDTHS[a["type"]]
        out = [(0.0,) * width] * a["count"]
        if "bufferView" in a:
            out = self._elements(a["bufferView"], a.get("byteOffset", 0), kind, width, a["count"])
        if "sparse" in a:
            sparse = a["sparse"]
            where = self._elements(sparse["indices"]["bufferView"],
                                   sparse["indices"].get("byteOffset", 0),
                                   sparse["indices"]["componentType"], 1, sparse["count"])
            values = self._elements(sparse["values"]["bufferView"],
                                    sparse["values"].get("byteOffset", 0), kind, width,
                                    sparse["count"])
            for (k,), value in zip(where, values, strict=True):
                out[int(k)] = value
        if a.get("normalized"):
            out = [tuple(max(x / LARGEST[kind], -1.0) for x in row) for row in out]
        return out

    def _elements(self, view: int, offset: int, kind: int, width: int, count: int
                  ) -> list[tuple[float, ...]]:
        v = self.g["bufferViews"][view]
        layout = struct.Struct("<" + FORMATS[kind] * width)
        stride = v.get("byteStride") or layout.size
        start = v.get("byteOffset", 0) + offset
        data = self.buffers[v["buffer"]]
        return [layout.unpack_from(data, start + k * stride) for k in range(count)]

    # -- poses ---------------------------------------------------------------------------------

    def keyed(self, animation: int | None, time: float) -> dict[tuple[int, str], list[float]]:
        """Values of all channels at a time, by (node, path)."""
        out: dict[tuple[int, str], list[float]] = {}
        if animation is None:
            return out
        a = self.g["animations"][animation]
        for channel in a["channels"]:
            target = channel["target"]
            if "node" not in target:
                continue
            sampler = a["samplers"][channel["sampler"]]
            times = [t for (t,) in self.accessor(sampler["input"])]
            flat = [x for row in self.accessor(sampler["output"]) for x in row]
            out[target["node"], target["path"]] = self._sample(
                times, flat, time, sampler.get("interpolation", "LINEAR"), target["path"])
        return out

    @staticmethod
    def _sample(times: list[float], flat: list[float], time: float, how: str, path: str
                ) -> list[float]:
        groups = 3 * len(times) if how == "CUBICSPLINE" else len(times)
        n = len(flat) // groups

        def group(k: int) -> list[float]:
            return list(flat[k * n:(k + 1) * n])

        def value(k: int) -> list[float]:
            return group(3 * k + 1) if how == "CUBICSPLINE" else group(k)

        if time <= times[0] or len(times) == 1:
            out = value(0)
        elif time >= times[-1]:
            out = value(len(times) - 1)
        else:
            k = max(i for i in range(len(times)) if times[i] <= time)
            td = times[k + 1] - times[k]
            t = (time - times[k]) / td
            if how == "STEP":
                out = value(k)
            elif how == "CUBICSPLINE":
                a, b = group(3 * k + 2), group(3 * k + 3)  # out-tangent here, in-tangent there
                out = [(2 * t**3 - 3 * t**2 + 1) * p0 + td * (t**3 - 2 * t**2 + t) * m0
                       + (-2 * t**3 + 3 * t**2) * p1 + td * (t**3 - t**2) * m1
                       for p0, m0, p1, m1 in zip(value(k), a, value(k + 1), b, strict=True)]
            elif path == "rotation":
                out = _slerp(value(k), value(k + 1), t)
            else:
                out = [x + t * (y - x) for x, y in zip(value(k), value(k + 1), strict=True)]
        if path == "rotation":
            length = math.sqrt(sum(x * x for x in out))
            out = [x / length for x in out]
        return out

    def local(self, n: int, keyed: dict[tuple[int, str], list[float]]) -> np.ndarray:
        node = self.g["nodes"][n]
        if "matrix" in node:
            return np.array(node["matrix"], float).reshape(4, 4).T
        t = keyed.get((n, "translation"), node.get("translation", [0, 0, 0]))
        x, y, z, w = keyed.get((n, "rotation"), node.get("rotation", [0, 0, 0, 1]))
        norm = math.sqrt(x * x + y * y + z * z + w * w)
        x, y, z, w = x / norm, y / norm, z / norm, w / norm
        s = keyed.get((n, "scale"), node.get("scale", [1, 1, 1]))
        shift, turn, stretch = np.eye(4), np.eye(4), np.diag([*s, 1.0])
        shift[:3, 3] = t
        turn[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]
        return shift @ turn @ stretch

    def worlds(self, keyed: dict[tuple[int, str], list[float]]) -> dict[int, np.ndarray]:
        nodes = self.g.get("nodes", [])
        children = {c for node in nodes for c in node.get("children", [])}
        out: dict[int, np.ndarray] = {}

        def descend(n: int, above: np.ndarray) -> None:
            out[n] = above @ self.local(n, keyed)
            for child in nodes[n].get("children", []):
                descend(child, out[n])

        for n in range(len(nodes)):
            if n not in children:
                descend(n, np.eye(4))
        return out

    def in_scene(self) -> list[int]:
        nodes = self.g.get("nodes", [])
        if "scenes" in self.g:
            stack = list(self.g["scenes"][self.g.get("scene", 0)].get("nodes", []))
        else:
            children = {c for node in nodes for c in node.get("children", [])}
            stack = [n for n in range(len(nodes)) if n not in children]
        out: list[int] = []
        while stack:
            n = stack.pop()
            out.append(n)
            stack.extend(nodes[n].get("children", []))
        return out

    def triangles(self, animation: int | None, time: float) -> np.ndarray:
        """[F 3 3] corners of all triangles in the world (y up), at a time (s)."""
        keyed = self.keyed(animation, time)
        worlds = self.worlds(keyed)
        found: list[np.ndarray] = []
        for n in self.in_scene():
            node = self.g["nodes"][n]
            if "mesh" not in node:
                continue
            mesh = self.g["meshes"][node["mesh"]]
            for primitive in mesh["primitives"]:
                attributes = primitive["attributes"]
                if primitive.get("mode", 4) < 4 or "POSITION" not in attributes:
                    continue
                points = np.array(self.accessor(attributes["POSITION"]), float)
                targets = primitive.get("targets", [])
                weights = keyed.get((n, "weights")) or node.get("weights") or mesh.get(
                    "weights") or [0.0] * len(targets)
                for weight, target in zip(weights, targets, strict=True):
                    if "POSITION" in target:
                        points = points + weight * np.array(self.accessor(target["POSITION"]))
                if "skin" in node:
                    points = self._skinned(points, attributes, self.g["skins"][node["skin"]],
                                           worlds)
                else:
                    points = points @ worlds[n][:3, :3].T + worlds[n][:3, 3]
                indices = ([int(i) for (i,) in self.accessor(primitive["indices"])]
                           if "indices" in primitive else list(range(len(points))))
                faces = _faces(indices, primitive.get("mode", 4))
                if faces:
                    found.append(points[np.array(faces)])
        return np.concatenate(found) if found else np.zeros((0, 3, 3))

    def _skinned(self, points: np.ndarray, attributes: dict[str, int], skin: dict[str, Any],
                 worlds: dict[int, np.ndarray]) -> np.ndarray:
        matrices: list[np.ndarray] = []
        for k, joint in enumerate(skin["joints"]):
            bind = np.eye(4)
            if "inverseBindMatrices" in skin:
                row = self.accessor(skin["inverseBindMatrices"])[k]
                bind = np.array(row, float).reshape(4, 4).T
            matrices.append(worlds[joint] @ bind)
        out = np.zeros_like(points)
        sets = [k for k in range(8) if f"JOINTS_{k}" in attributes]
        for v in range(len(points)):
            pairs = [(int(j), w) for k in sets
                     for j, w in zip(self.accessor(attributes[f"JOINTS_{k}"])[v],
                                     self.accessor(attributes[f"WEIGHTS_{k}"])[v], strict=True)]
            total = sum(w for _, w in pairs)
            if total <= 0:
                pairs, total = [(pairs[0][0], 1.0)], 1.0
            blend = sum(w / total * matrices[j] for j, w in pairs if w > 0)
            out[v] = (blend @ np.array([*points[v], 1.0]))[:3]
        return out


def _slerp(a: list[float], b: list[float], t: float) -> list[float]:
    a, b = ([x / math.sqrt(sum(y * y for y in q)) for x in q] for q in (a, b))
    dot = sum(x * y for x, y in zip(a, b, strict=True))
    if dot < 0:
        b, dot = [-y for y in b], -dot
    if dot > 1 - 1e-10:
        return [x + t * (y - x) for x, y in zip(a, b, strict=True)]
    angle = math.acos(min(dot, 1.0))
    return [(math.sin((1 - t) * angle) * x + math.sin(t * angle) * y) / math.sin(angle)
            for x, y in zip(a, b, strict=True)]


def _faces(indices: list[int], mode: int) -> list[tuple[int, int, int]]:
    if mode == 4:
        return [(indices[k], indices[k + 1], indices[k + 2])
                for k in range(0, len(indices) - 2, 3)]
    if mode == 5:
        return [(indices[k], indices[k + 1 + k % 2], indices[k + 2 - k % 2])
                for k in range(len(indices) - 2)]
    return [(indices[k + 1], indices[k + 2], indices[0]) for k in range(len(indices) - 2)]
