"""The decoded textures of one model are bounded, whichever file names them."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from gcbench.errors import ModelError
from gcbench.robots.gltf.reader import load_gltf
from gcbench.robots.model import TextureDecoder
from gcbench.robots.urdf.reader import load_urdf
from PIL import Image

from ...support.gltf_maker import Maker

SQUARE = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
UV = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], float)
FACES = [[0, 1, 2], [0, 2, 3]]
SIDE = 64
BYTES = SIDE * SIDE * 3


def png(shade: int, side: int = SIDE, kind: str = "PNG") -> bytes:
    out = io.BytesIO()
    Image.new("RGB", (side, side), (shade, 0, 0)).save(out, kind)
    return out.getvalue()


def urdf_of_boxes(folder: Path, count: int, shades: int) -> Path:
    """Boxes with textures of their own, of which `shades` differ."""
    visuals = ""
    for i in range(count):
        (folder / f"t{i}.png").write_bytes(png(i % shades))
        visuals += (f'<visual><geometry><box size="1 1 1"/></geometry><material name="m{i}">'
                    f'<texture filename="t{i}.png"/></material></visual>')
    path = folder / "boxes.urdf"
    path.write_text(f'<robot name="r"><link name="a">{visuals}</link></robot>')
    return path


def urdf_of_meshes(folder: Path, suffix: str, count: int, shades: int) -> Path:
    """Meshes, each with its own texture, of which `shades` differ."""
    visuals = ""
    for i in range(count):
        if suffix == "glb":
            textured_glb([png(i % shades)]).save(folder, f"m{i}.glb")
        else:
            (folder / f"t{i}.png").write_bytes(png(i % shades))
            (folder / f"m{i}.mtl").write_text(f"newmtl a\nmap_Kd t{i}.png\n")
            (folder / f"m{i}.obj").write_text(
                f"mtllib m{i}.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl a\n"
                "f 1/1 2/2 3/3\n")
        visuals += f'<visual><geometry><mesh filename="m{i}.{suffix}"/></geometry></visual>'
    path = folder / "meshes.urdf"
    path.write_text(f'<robot name="r"><link name="a">{visuals}</link></robot>')
    return path


def textured_glb(images: list[bytes], **normal: float) -> Maker:
    """A square of a material for each image; a view of the file is shared by equal ones."""
    maker = Maker()
    views = {data: maker.view(data) for data in dict.fromkeys(images)}
    for data in images:
        image = maker.add("images", bufferView=views[data])
        texture = maker.add("textures", source=image)
        info = {"index": texture}
        material = maker.add("materials", pbrMetallicRoughness={"baseColorTexture": info}, **(
            {"normalTexture": {**info, **normal}} if normal else {}))
        maker.node(mesh=maker.mesh(SQUARE, FACES, primitive={"material": material},
                                   TEXCOORD_0=maker.accessor(UV)))
    return maker


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Room for three of the textures above."""
    monkeypatch.setattr(TextureDecoder.__init__, "__defaults__", (3 * BYTES + 10,))


@pytest.mark.parametrize("kind", ["box", "obj", "glb"])
def test_textures_that_a_urdf_reaches(tmp_path: Path, small: None, kind: str) -> None:
    def model(count: int, shades: int) -> Path:
        return (urdf_of_boxes(tmp_path, count, shades) if kind == "box"
                else urdf_of_meshes(tmp_path, kind, count, shades))

    with pytest.raises(ModelError, match=r"\.urdf: .*the model's textures exceed \d+ bytes"):
        load_urdf(model(4, 4))
    shared = load_urdf(model(12, 3))  # equal files count once
    textures = [v.material.texture for v in shared.visuals]
    assert len({id(t) for t in textures}) == 3 and all(t is not None for t in textures)


def test_textures_of_a_gltf_model(tmp_path: Path, small: None) -> None:
    with pytest.raises(ModelError, match=r"m\.glb: .*images\[3\]: the model's textures exceed"):
        load_gltf(textured_glb([png(k) for k in range(4)]).save(tmp_path))
    assert load_gltf(textured_glb([png(1)] * 100).save(tmp_path)).visuals
    with pytest.raises(ModelError, match="a material: the model's textures exceed"):
        load_gltf(textured_glb([png(1)] * 100, scale=0.5).save(tmp_path))


def test_an_image_is_refused_before_it_is_decoded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Image.Image, "convert", lambda *_: pytest.fail("was decoded"))
    with pytest.raises(ModelError, match="big: the model's textures exceed 1000 bytes"):
        TextureDecoder(1000).decode(png(0), "big")


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "BMP", "TGA", "TIFF", "GIF", "WEBP"])
def test_obj_textures_of_every_format(tmp_path: Path, kind: str) -> None:
    path = urdf_of_meshes(tmp_path, "obj", 1, 1)
    (tmp_path / f"t0.{kind.lower()}").write_bytes(png(200, kind=kind))
    (tmp_path / "m0.mtl").write_text(f"newmtl a\nmap_Kd t0.{kind.lower()}\n")
    texture = load_urdf(path).visuals[0].material.texture
    assert texture is not None and texture.shape == (SIDE, SIDE, 3)
    assert abs(int(texture[0, 0, 0]) - 200) < 8


def test_messages_name_no_object_of_python() -> None:
    with pytest.raises(ModelError, match=r"^t\.png: is not an image of a known format \(PNG"):
        TextureDecoder().decode(b"hello", "t.png")
    with pytest.raises(ModelError, match=r"^t\.png: is a damaged image") as caught:
        TextureDecoder().decode(png(3)[:-30], "t.png")
    assert "0x" not in str(caught.value)
