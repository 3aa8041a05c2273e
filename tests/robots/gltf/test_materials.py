"""Materials of glTF models: what is read, and that holes are holes in colour, depth and parts."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gcbench.renderer.gl.rasterizer import Rasterizer
from gcbench.renderer.scene.posed_model import rest
from gcbench.renderer.scene.scene import Light, Scene
from gcbench.renderer.types.camera import Camera, intrinsics_from_fov, look_at
from gcbench.robots.files.paths import MissingAssetError
from gcbench.robots.gltf.reader import load_gltf
from gcbench.robots.model import ArticulatedModel, Visual
from gcbench.robots.motion.trajectory import JointTrajectory
from PIL import Image

from ...support.gltf_maker import Maker

SQUARE = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
UV = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], float)
"""v downward, so that the picture stands upright."""
FACES = [[0, 1, 2], [0, 2, 3]]


def png(pixels: np.ndarray) -> bytes:
    out = io.BytesIO()
    Image.fromarray(pixels.astype(np.uint8)).save(out, "PNG")
    return out.getvalue()


def add_texture(maker: Maker, pixels: np.ndarray, **sampler: int) -> int:
    image = maker.add("images", bufferView=maker.view(png(pixels)), mimeType="image/png")
    return maker.add("textures", source=image, sampler=maker.add("samplers", **sampler))


def square(maker: Maker, uv: np.ndarray = UV, **fields: Any) -> None:
    """A square that faces glTF's z, with a material of these fields."""
    material = maker.add("materials", **fields)
    maker.node(mesh=maker.mesh(SQUARE, FACES, primitive={"material": material},
                               TEXCOORD_0=maker.accessor(uv)))


def only(maker: Maker, folder: Path) -> Visual:
    (visual,) = load_gltf(maker.save(folder)).visuals
    return visual


# -- what is read ----------------------------------------------------------------------------


def test_factors_and_textures(tmp_path: Path) -> None:
    maker = Maker()
    pictures = [np.full((2, 2, 3), k) for k in range(10, 60, 10)]
    color, metal, normal, shade, glow = (add_texture(maker, p, wrapS=33071, wrapT=33648)
                                         for p in pictures)
    square(maker, name="paint", emissiveFactor=[0.5, 0.25, 0.0], alphaMode="BLEND",
           emissiveTexture={"index": glow}, normalTexture={"index": normal},
           occlusionTexture={"index": shade}, pbrMetallicRoughness={
               "baseColorFactor": [0.1, 0.2, 0.3, 0.4], "metallicFactor": 0.5,
               "roughnessFactor": 0.25, "baseColorTexture": {"index": color},
               "metallicRoughnessTexture": {"index": metal}},
           extensions={"KHR_materials_emissive_strength": {"emissiveStrength": 4.0}})
    m = only(maker, tmp_path).material
    assert (m.name, m.base_color, m.metallic, m.roughness) == ("paint", (0.1, 0.2, 0.3, 0.4), 0.5,
                                                               0.25)
    assert (m.emission, m.tiling, m.transparent) == ((2.0, 1.0, 0.0), ("clamp", "mirror"), True)
    found = (m.texture, m.maps.metallic_roughness, m.maps.normal, m.maps.occlusion,
             m.maps.emission)
    for picture, wanted in zip(found, pictures, strict=True):
        np.testing.assert_array_equal(picture, wanted)


def test_without_a_material_it_is_white_and_metallic_as_the_format_says(tmp_path: Path) -> None:
    maker = Maker()
    maker.node(mesh=maker.mesh(SQUARE, FACES))
    m = only(maker, tmp_path).material
    assert (m.base_color, m.metallic, m.roughness) == ((1, 1, 1, 1), 1.0, 1.0)


def test_alpha_modes(tmp_path: Path) -> None:
    rgba = np.full((2, 2, 4), 100)
    modes = {"OPAQUE": (3, None, False), "MASK": (4, 0.25 / 0.5, False), "BLEND": (4, 0.02, True)}
    for mode, (channels, cutoff, blend) in modes.items():
        maker = Maker()
        square(maker, alphaMode=mode, pbrMetallicRoughness={
            "baseColorFactor": [1, 1, 1, 0.5],
            "baseColorTexture": {"index": add_texture(maker, rgba)}},
            **({"alphaCutoff": 0.25} if mode == "MASK" else {}))
        m = only(maker, tmp_path).material
        assert m.texture is not None and m.texture.shape[2] == channels
        assert (m.alpha_cutoff, m.blend) == (cutoff, blend)
        assert m.base_color[3] == (0.5 if mode == "BLEND" else 1.0)


def test_each_glossy_material_has_a_picture_of_its_own(tmp_path: Path) -> None:
    maker = Maker()
    black, white = (add_texture(maker, np.full((4, 4, 4), v)) for v in (0, 255))
    shines = np.linspace(0.3, 1.0, 200)
    for shine in shines:
        square(maker, extensions={"KHR_materials_pbrSpecularGlossiness": {
            "diffuseTexture": {"index": black}, "specularFactor": [shine] * 3,
            "specularGlossinessTexture": {"index": white}}})
    textures = [v.material.texture for v in load_gltf(maker.save(tmp_path)).visuals]
    found = [float(t.mean()) for t in textures if t is not None]
    np.testing.assert_allclose(found, (255 * shines - 56) * 255 / 199, atol=1.0)


def test_texture_coordinates_are_turned_as_the_extension_says(tmp_path: Path) -> None:
    """Its own example: the lower left quadrant of the image, turned clockwise by 90 degrees."""
    maker = Maker()
    moved = {"offset": [0, 1], "rotation": np.pi / 2, "scale": [0.5, 0.5]}
    square(maker, pbrMetallicRoughness={"baseColorTexture": {
        "index": add_texture(maker, np.zeros((2, 2, 3))),
        "extensions": {"KHR_texture_transform": moved}}})
    visual = only(maker, tmp_path)
    assert visual.uv is not None
    wanted = {(-1.0, -1.0): (0.5, 0.0), (1.0, -1.0): (0.5, 0.5), (1.0, 1.0): (0.0, 0.5),
              (-1.0, 1.0): (0.0, 0.0)}  # (x, y) on the square: (u, v upward)
    for (x, y, _), uv in zip(visual.vertices, visual.uv, strict=True):
        np.testing.assert_allclose(uv, wanted[x, y], atol=1e-6)


def test_vertex_colours(tmp_path: Path) -> None:
    colors = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 255]])
    maker = Maker()
    maker.node(mesh=maker.mesh(SQUARE, FACES,
                               COLOR_0=maker.accessor(colors, "B", normalized=True)))
    visual = only(maker, tmp_path)
    assert visual.color is not None
    for vertex, color in zip(visual.vertices, visual.color, strict=True):
        corner = int(np.abs(SQUARE - vertex).sum(1).argmin())
        np.testing.assert_allclose(color, [*(colors[corner] / 255.0), 1.0])


def test_a_missing_picture_stops_the_load_or_is_noted(tmp_path: Path) -> None:
    maker = Maker()
    maker.add("images", uri="gone.png")
    maker.add("textures", source=0)
    square(maker, pbrMetallicRoughness={"baseColorTexture": {"index": 0}})
    path = maker.save(tmp_path)
    with pytest.raises(MissingAssetError, match=r"gone\.png"):
        load_gltf(path)
    assert "images[0] is missing" in load_gltf(path, allow_missing=True).notes
    (tmp_path / "gone.png").write_bytes(png(np.zeros((2, 2, 3))))
    assert load_gltf(path).visuals[0].material.texture is not None


# -- what is drawn ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def rasterizer() -> Iterator[Rasterizer]:
    made = Rasterizer(64, 48, finer=1)
    yield made
    made.close()


def shot(rasterizer: Rasterizer, model: ArticulatedModel
         ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Depth, part and colour of a model seen from glTF's z, 4 m away, without any light but
    ambient white.
    """
    camera = Camera(64, 48, intrinsics_from_fov(64, 48, np.radians(40.0)),
                    look_at(np.array([0.0, -4.0, 0.0]), np.zeros(3), 0.0))
    light = Light(np.array([0.0, 1.0, 0.0]), (0.0, 0.0, 0.0), 0.0)
    scene = Scene(
        model, JointTrajectory(np.zeros(1), np.zeros((1, len(model.joint_names)))), (camera,),
        (light,), 1.0, False, tuple(v.material for v in model.visuals),
        np.zeros(len(model.visuals)), np.full((48, 64, 3), 10, np.uint8), (), 0.0, 0, 0.0, 0.0)
    posed = rest(model)
    truth = rasterizer.draw_truth(posed, camera)
    return truth.depth, truth.part, rasterizer.draw_color(scene, posed).rgb


@pytest.mark.gl
def test_a_mask_cuts_holes_into_colour_depth_and_part(
    tmp_path: Path, rasterizer: Rasterizer
) -> None:
    leaf = np.full((32, 32, 4), 255)
    leaf[:, 16:, 3] = 0  # its right half is not there
    seen: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}
    for mode in ("OPAQUE", "MASK"):
        maker = Maker()
        square(maker, alphaMode=mode, pbrMetallicRoughness={
            "baseColorTexture": {"index": add_texture(maker, leaf, wrapS=33071, wrapT=33071)}})
        seen[mode] = shot(rasterizer, load_gltf(maker.save(tmp_path)))
    whole, cut = seen["OPAQUE"][1] > 0, seen["MASK"][1] > 0
    left = np.arange(64) < 32
    assert np.count_nonzero(whole) > 500
    np.testing.assert_array_equal(cut, whole & left)
    depth, part, rgb = seen["MASK"]
    np.testing.assert_array_equal(depth > 0, part > 0)
    assert (rgb[whole & ~left] == 10).all() and (rgb[cut] > 200).all()


@pytest.mark.gl
def test_what_a_blended_vertex_colour_hides_is_in_no_layer(
    tmp_path: Path, rasterizer: Rasterizer
) -> None:
    low, high = (SQUARE * [1, 0.5, 1] + np.array([0, y, 0]) for y in (-0.5, 0.5))
    halves = np.concatenate([low, high])
    rgba = np.ones((8, 4))
    seen: dict[float, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}
    for alpha in (0.0, 1.0):
        rgba[:4, 3] = alpha  # of the lower half
        maker = Maker()
        material = maker.add("materials", alphaMode="BLEND")
        maker.node(mesh=maker.mesh(
            halves, [*FACES, *np.add(FACES, 4)], primitive={"material": material},
            COLOR_0=maker.accessor(rgba)))
        model = load_gltf(maker.save(tmp_path))
        assert model.visuals[0].material.alpha_cutoff == (None if alpha else 0.02)
        seen[alpha] = shot(rasterizer, model)
    depth, part, rgb = seen[0.0]
    np.testing.assert_array_equal(depth > 0, part > 0)
    upper = np.arange(48)[:, None] < 24
    np.testing.assert_array_equal(part > 0, (seen[1.0][1] > 0) & upper)
    assert np.count_nonzero(part) > 300 and (rgb[24:] == 10).all()


@pytest.mark.gl
def test_pictures_stand_upright_and_vertex_colours_multiply(
    tmp_path: Path, rasterizer: Rasterizer
) -> None:
    picture = np.zeros((2, 2, 3))
    picture[0, 0], picture[0, 1] = [255, 0, 0], [0, 255, 0]  # top left red, top right green
    picture[1, 0], picture[1, 1] = [0, 0, 255], [255, 255, 255]
    maker = Maker()
    material = maker.add("materials", extensions={"KHR_materials_unlit": {}}, pbrMetallicRoughness={
        "baseColorTexture": {"index": add_texture(maker, picture, wrapS=33071, wrapT=33071)}})
    maker.node(mesh=maker.mesh(
        SQUARE, FACES, primitive={"material": material}, TEXCOORD_0=maker.accessor(UV),
        COLOR_0=maker.accessor(np.tile([1.0, 1.0, 0.0], (4, 1)))))
    _, part, rgb = shot(rasterizer, load_gltf(maker.save(tmp_path)))
    rows, columns = np.flatnonzero((part > 0).any(1)), np.flatnonzero((part > 0).any(0))
    top, bottom, left, right = rows[2], rows[-3], columns[2], columns[-3]
    assert rgb[top, left].argmax() == 0 and rgb[top, right].argmax() == 1
    assert rgb[bottom, left].max() < 60  # blue times yellow
    assert rgb[bottom, right, :2].min() > 200 and rgb[bottom, right, 2] < 60


@pytest.mark.gl
def test_emission_and_occlusion(tmp_path: Path, rasterizer: Rasterizer) -> None:
    def grey(**fields: Any) -> float:
        maker = Maker()
        black = {"baseColorFactor": [0.25, 0.25, 0.25, 1.0], "metallicFactor": 0.0}
        dark = add_texture(maker, np.full((2, 2, 3), 128))
        if "occlusionTexture" in fields:
            fields["occlusionTexture"] = {"index": dark, **fields["occlusionTexture"]}
        square(maker, pbrMetallicRoughness=black, **fields)
        _, part, rgb = shot(rasterizer, load_gltf(maker.save(tmp_path)))
        return float((rgb[part > 0].mean() / 255.0) ** 2.2)

    plain = grey()
    assert plain == pytest.approx(0.25, abs=0.01)  # ambient light alone
    assert grey(emissiveFactor=[0.5] * 3) == pytest.approx(0.75, abs=0.02)
    assert grey(occlusionTexture={}) == pytest.approx(0.25 * 128 / 255, abs=0.01)
    assert grey(occlusionTexture={"strength": 0.0}) == pytest.approx(0.25, abs=0.01)


def test_pictures_of_16_bits_are_scaled(tmp_path: Path) -> None:
    grey = np.array([[0, 0x8000], [0x4000, 0xFFFF]], np.uint16)
    out = io.BytesIO()
    Image.fromarray(grey).save(out, "PNG")
    maker = Maker()
    maker.add("images", bufferView=maker.view(out.getvalue()))
    maker.add("textures", source=0)
    square(maker, pbrMetallicRoughness={"baseColorTexture": {"index": 0}})
    texture = only(maker, tmp_path).material.texture
    assert texture is not None
    np.testing.assert_array_equal(texture[..., 0], grey >> 8)
