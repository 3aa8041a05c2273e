"""Makes small glTF files for tests, with nothing but JSON and NumPy."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

KINDS = {"b": 5120, "B": 5121, "h": 5122, "H": 5123, "I": 5125, "f": 5126}
WIDTHS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}

CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
CUBE = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
                 [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]])
"""Faces of the unit cube, counter-clockwise from outside."""


class Maker:
    """Collects objects; `tree` is the document, which tests may break as they like."""

    def __init__(self) -> None:
        self.tree: dict[str, Any] = {"asset": {"version": "2.0"}}
        self.data = bytearray()

    def add(self, kind: str, **fields: Any) -> int:
        """One more object of a kind ("nodes"); its number."""
        self.tree.setdefault(kind, []).append(fields)
        return len(self.tree[kind]) - 1

    def view(self, data: bytes, **fields: Any) -> int:
        self.data += bytes(-len(self.data) % 4)
        self.data += data
        return self.add("bufferViews", buffer=0, byteOffset=len(self.data) - len(data),
                        byteLength=len(data), **fields)

    def accessor(self, values: ArrayLike, code: str = "f", **fields: Any) -> int:
        """An accessor of values [N] or [N width], component type by struct's letter."""
        array = np.asarray(values)
        width = 1 if array.ndim == 1 else array.shape[1]
        return self.add("accessors", bufferView=self.view(array.astype(f"<{code}").tobytes()),
                        componentType=KINDS[code], count=len(array), type=WIDTHS[width], **fields)

    def mesh(self, points: ArrayLike = CORNERS, faces: ArrayLike = CUBE,
             targets: list[dict[str, int]] | None = None, mesh: dict[str, Any] | None = None,
             primitive: dict[str, Any] | None = None, **attributes: int) -> int:
        """A mesh of one primitive."""
        made: dict[str, Any] = {
            "attributes": {"POSITION": self.accessor(points), **attributes},
            "indices": self.accessor(np.ravel(np.asarray(faces)), "H"), **(primitive or {})}
        if targets is not None:
            made["targets"] = targets
        return self.add("meshes", primitives=[made], **(mesh or {}))

    def node(self, parent: int | None = None, **fields: Any) -> int:
        number = self.add("nodes", **fields)
        if parent is not None:
            self.tree["nodes"][parent].setdefault("children", []).append(number)
        return number

    def skin(self, joints: list[int], binds: ArrayLike | None = None) -> int:
        """Inverse bind matrices [B 4 4]."""
        fields: dict[str, Any] = {"joints": joints}
        if binds is not None:
            columns = np.asarray(binds, float).swapaxes(1, 2).reshape(-1, 16)
            fields["inverseBindMatrices"] = self.accessor(columns)
        return self.add("skins", **fields)

    def animate(self, tracks: list[tuple[int, str, ArrayLike, ArrayLike, str]],
                **fields: Any) -> int:
        """(node, path, times, values, interpolation) of each channel."""
        channels: list[dict[str, Any]] = []
        samplers: list[dict[str, Any]] = []
        for k, (node, path, times, values, how) in enumerate(tracks):
            samplers.append({"input": self.accessor(times), "output": self.accessor(values),
                             "interpolation": how})
            channels.append({"sampler": k, "target": {"node": node, "path": path}})
        return self.add("animations", channels=channels, samplers=samplers, **fields)

    def scene(self, *nodes: int) -> None:
        self.tree["scene"] = self.add("scenes", nodes=list(nodes))

    def glb(self) -> bytes:
        tree = dict(self.tree)
        blob = bytes(self.data) + bytes(-len(self.data) % 4)
        if blob and "buffers" not in tree:
            tree["buffers"] = [{"byteLength": len(blob)}]
        text = json.dumps(tree).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
        if blob:
            chunks += struct.pack("<II", len(blob), 0x004E4942) + blob
        return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks

    def gltf(self) -> str:
        """As text, with the buffer inside."""
        uri = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
        buffers = [{"byteLength": len(self.data), "uri": uri}] if self.data else []
        return json.dumps({"buffers": buffers, **self.tree} if buffers else self.tree)

    def save(self, folder: Path, name: str = "m.glb") -> Path:
        path = folder / name
        path.write_bytes(self.glb() if name.endswith(".glb") else self.gltf().encode())
        return path


def bar(maker: Maker, rings: int = 9) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A square bar from y = 0 to 2: points, faces, and each point's share (0..1) of the way up."""
    height = np.linspace(0.0, 2.0, rings)
    square = np.array([[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]])
    points = np.array([[x, y, z] for y in height for x, z in square])
    faces: list[list[int]] = []
    for r in range(rings - 1):
        for k in range(4):
            a, b = 4 * r + k, 4 * r + (k + 1) % 4
            faces += [[a, a + 4, b], [b, a + 4, b + 4]]
    return points, np.array(faces), points[:, 1] / 2.0


def bent_bar(maker: Maker, code: str = "H") -> tuple[int, int, int]:
    """A bar of two bones, hinged in its middle: the numbers of base, tip and mesh node."""
    points, faces, up = bar(maker)
    upper = np.clip((up - 0.25) / 0.5, 0.0, 1.0)
    zero = np.zeros_like(upper)
    mesh = maker.mesh(
        points, faces, JOINTS_0=maker.accessor(np.stack([zero, zero + 1, zero, zero], 1), code),
        WEIGHTS_0=maker.accessor(np.stack([1 - upper, upper, zero, zero], 1)))
    base = maker.node(name="base")
    tip = maker.node(base, name="tip", translation=[0, 1, 0])
    binds = np.tile(np.eye(4), (2, 1, 1))
    binds[1, 1, 3] = -1.0
    body = maker.node(mesh=mesh, skin=maker.skin([base, tip], binds), name="body",
                      translation=[5, 5, 5])
    maker.scene(base, body)
    return base, tip, body
