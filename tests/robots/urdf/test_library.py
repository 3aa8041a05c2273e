"""Mesh files and primitives: units, nodes, materials, normals."""

from __future__ import annotations

import base64
import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gcbench.errors import ModelError
from gcbench.robots.files.paths import asset_finder
from gcbench.robots.geometry.normals import face_normals, smooth_corners
from gcbench.robots.meshes.solids import box, capsule, cylinder, sphere
from gcbench.robots.model import (
    Maps,
    Material,
    TriangleSurface,
    clean_surface,
    move_surface,
    visuals_of_part,
)
from gcbench.robots.model.texture import linear_from_srgb
from gcbench.robots.urdf.library import MeshLibrary
from PIL import Image

TETRA = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
TETRA_FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def library(folder: Path) -> MeshLibrary:
    return MeshLibrary(asset_finder(folder / "model.urdf", asset_root=folder))


def volume(s: TriangleSurface) -> float:
    """Positive where faces turn counter-clockwise seen from outside."""
    a, b, c = (s.vertices[s.faces[:, i]] for i in range(3))
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6.0)


def agreement(s: TriangleSurface) -> float:
    """The least cosine between a face and its corners' normals."""
    flat, _ = face_normals(s.vertices, s.faces)
    return float(np.einsum("fci,fi->fc", s.normals[s.faces], flat).min())


def obj_text(extra: str = "") -> str:
    return (extra + "".join(f"v {x} {y} {z}\n" for x, y, z in TETRA)
            + "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in TETRA_FACES))


def stl_binary() -> bytes:
    facets = b"".join(struct.pack("<12fH", 0, 0, 0, *TETRA[f].ravel(), 0) for f in TETRA_FACES)
    return bytes(80) + struct.pack("<I", 4) + facets


def stl_ascii() -> str:
    loops = "".join("facet normal 0 0 0\nouter loop\n" + "".join(
        f"vertex {x} {y} {z}\n" for x, y, z in TETRA[f]) + "endloop\nendfacet\n"
        for f in TETRA_FACES)
    return f"solid t\n{loops}endsolid t\n"


def ply_ascii(colored: bool = False) -> str:
    color = "property uchar red\nproperty uchar green\nproperty uchar blue\n" if colored else ""
    return ("ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
            f"property float z\n{color}element face 4\nproperty list uchar int vertex_indices\n"
            "end_header\n" + "".join(f"{x} {y} {z}{' 255 0 0' if colored else ''}\n"
                                     for x, y, z in TETRA)
            + "".join(f"3 {a} {b} {c}\n" for a, b, c in TETRA_FACES))


def dae_text(nodes: str = "", asset: str = "", effect: str = "", target: str = "#m") -> str:
    positions = " ".join(f"{x}" for x in TETRA.ravel())
    index = " ".join(map(str, TETRA_FACES.ravel()))
    bind = ('<bind_material><technique_common><instance_material symbol="s" '
            f'target="{target}"/></technique_common></bind_material>')
    nodes = nodes or '<node><instance_geometry url="#g">BIND</instance_geometry></node>'
    effect = effect or "<diffuse><color>0.5 0.25 1 1</color></diffuse>"
    return f"""<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>{asset}</asset>
<library_images><image id="i"><init_from>../images/t.png</init_from></image></library_images>
<library_effects><effect id="e"><profile_COMMON>
<newparam sid="sf"><surface type="2D"><init_from>i</init_from></surface></newparam>
<newparam sid="sa"><sampler2D><source>sf</source></sampler2D></newparam>
<technique sid="c"><lambert>{effect}</lambert></technique></profile_COMMON></effect>
</library_effects><library_materials><material id="m" name="paint"><instance_effect url="#e"/>
</material></library_materials><library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="12">{positions}</float_array><technique_common>
<accessor source="#pa" count="4" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles material="s" count="4"><input semantic="VERTEX" source="#v" offset="0"/>
<p>{index}</p></triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="sc">{nodes.replace("BIND", bind)}</visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#sc"/></scene></COLLADA>"""


def gltf(**extra: object) -> dict[str, object]:
    data = TETRA.astype("<f4").tobytes() + TETRA_FACES.astype("<u2").tobytes()
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    return {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "translation": [0, 0, 5], "scale": [2, 2, 2]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [0.2, 0.4, 0.6, 1.0],
                                                "metallicFactor": 0.25, "roughnessFactor": 0.5}}],
        "buffers": [{"byteLength": len(data), "uri": uri}],
        "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": 48},
                        {"buffer": 0, "byteOffset": 48, "byteLength": 24}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3",
                       "min": [0, 0, 0], "max": [1, 1, 1]},
                      {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"}],
        **extra,
    }


FILES: dict[str, str | bytes] = {
    "a.obj": obj_text(), "B.STL": stl_binary(), "c.stl": stl_ascii(), "d.ply": ply_ascii(),
    "E.DAE": dae_text(),
}


@pytest.mark.parametrize("name", FILES)
def test_every_format_gives_the_same_tetrahedron(tmp_path: Path, name: str) -> None:
    content = FILES[name]
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    (s,) = library(tmp_path).surfaces(name)
    assert len(s.faces) == 4 and s.vertices.dtype == np.float64
    np.testing.assert_allclose(volume(s), 1 / 6, rtol=1e-6)
    assert agreement(s) > 0.999  # sharp edges stay sharp


def test_dae_units_apply_and_the_up_axis_does_not(tmp_path: Path) -> None:
    nodes = ('<node><translate>0 0 10</translate><instance_geometry url="#g">BIND'
             "</instance_geometry></node>"
             '<node><scale>1 1 3</scale><node><instance_geometry url="#g"/></node></node>')
    for axis in ("Y_UP", "Z_UP"):
        asset = f'<unit meter="0.01"/><up_axis>{axis}</up_axis>'
        (tmp_path / f"{axis}.dae").write_text(dae_text(nodes, asset))
        lib = library(tmp_path)
        first, second = lib.surfaces(f"{axis}.dae")
        np.testing.assert_allclose(first.vertices.max(0), [0.01, 0.01, 0.11], rtol=1e-6)
        np.testing.assert_allclose(second.vertices.max(0), [0.01, 0.01, 0.03], rtol=1e-6)
        assert any("up axis" in n for n in lib.notes) == (axis == "Y_UP")


def test_dae_colours_are_linear_and_broken_materials_lose_no_geometry(tmp_path: Path) -> None:
    (tmp_path / "a.dae").write_text(dae_text())
    (s,) = library(tmp_path).surfaces("a.dae")
    assert s.material is not None
    np.testing.assert_allclose(s.material.base_color[:3], linear_from_srgb([0.5, 0.25, 1]))
    (tmp_path / "b.dae").write_text(dae_text(target="#gone"))
    lib = library(tmp_path)
    (s,) = lib.surfaces("b.dae")
    assert s.material is None and any("gone" in n for n in lib.notes)


def test_dae_texture_beside_the_mesh_folder(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    (tmp_path / "meshes").mkdir()
    Image.new("RGB", (3, 2), (10, 20, 30)).save(tmp_path / "images" / "t.png")
    (tmp_path / "meshes" / "a.dae").write_text(
        dae_text(effect='<diffuse><texture texture="sa" texcoord="UV"/></diffuse>'))
    (s,) = library(tmp_path).surfaces("meshes/a.dae")
    assert s.material is not None and s.material.texture is not None
    assert s.material.texture.shape == (2, 3, 3)
    assert s.material.texture[0, 0].tolist() == [10, 20, 30]


def test_obj_materials_and_textures_above_the_mesh_folder(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    (tmp_path / "objs").mkdir()
    pixels = np.zeros((2, 2, 3), np.uint8)
    pixels[0, 1] = [1, 2, 3]
    Image.fromarray(pixels).save(tmp_path / "images" / "x.png")
    (tmp_path / "objs" / "m.mtl").write_text(
        "newmtl red\nKd 1 0.5 0\nd 0.25\nnewmtl tex\nKd 0 0 0\nmap_Kd ../images/x.png\n")
    (tmp_path / "objs" / "a.obj").write_text(
        "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"
        "usemtl red\nf 1/1 2/2 3/3\nusemtl tex\nf 1/1 3/3 2/2\n")
    lib = library(tmp_path)
    by_name = {s.material.name: s for s in lib.surfaces("objs/a.obj") if s.material}
    red, tex = by_name["red"], by_name["tex"]
    assert red.material and tex.material and tex.material.texture is not None
    np.testing.assert_allclose(red.material.base_color, [1, linear_from_srgb(0.5), 0, 0.25])
    assert tex.material.base_color == (1, 1, 1, 1)
    assert tex.material.texture[0, 1].tolist() == [1, 2, 3]  # row 0 is the top
    assert tex.uv is not None
    for p, uv in zip(tex.vertices, tex.uv, strict=True):
        np.testing.assert_allclose(p[:2], uv)
    assert not lib.notes


def test_a_color_that_is_no_number_is_gray(tmp_path: Path) -> None:
    (tmp_path / "m.mtl").write_text("newmtl odd\nKd 0.8 NaN 0\n")
    (tmp_path / "a.obj").write_text(
        "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl odd\nf 1 2 3\n")
    (surface,) = library(tmp_path).surfaces("a.obj")
    assert surface.material
    np.testing.assert_allclose(surface.material.base_color, [*[linear_from_srgb(0.5)] * 3, 1])


@pytest.mark.parametrize("head", ["", "mtllib gone.mtl\nusemtl a\n"])
def test_texture_coordinates_need_no_material(tmp_path: Path, head: str) -> None:
    """trimesh invents an image for them, which has no file."""
    (tmp_path / "a.obj").write_text(
        f"{head}v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n")
    (surface,) = library(tmp_path).surfaces("a.obj")
    assert surface.material is None


def test_a_material_file_that_is_missing_is_noted(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(obj_text("mtllib gone.mtl\n"))
    lib = library(tmp_path)
    assert lib.surfaces("a.obj")[0].material is None
    assert list(lib.notes) == ["a.obj: file 'gone.mtl' is missing"]


def test_gltf_nodes_and_linear_colours(tmp_path: Path) -> None:
    (tmp_path / "a.gltf").write_text(json.dumps(gltf()))
    (s,) = library(tmp_path).surfaces("a.gltf")
    np.testing.assert_allclose(s.vertices.max(0), [2, 2, 7])
    assert s.material is not None
    np.testing.assert_allclose(s.material.base_color[:3], [0.2, 0.4, 0.6], atol=3e-3)
    assert (s.material.metallic, s.material.roughness) == (0.25, 0.5)


def test_gltf_extensions_that_change_the_data_are_refused_by_name(tmp_path: Path) -> None:
    text = json.dumps(gltf(extensionsRequired=["KHR_draco_mesh_compression"]))
    (tmp_path / "a.gltf").write_text(text)
    with pytest.raises(ModelError, match=r"a\.gltf.*KHR_draco_mesh_compression"):
        library(tmp_path).surfaces("a.gltf")


def test_vertex_colours_are_the_last_resort(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_text(ply_ascii(colored=True))
    meshes = library(tmp_path)
    (s,) = meshes.surfaces("a.ply")
    assert s.material is None and s.vertex_color == (1, 0, 0, 1) and not meshes.notes
    (tmp_path / "b.ply").write_text(ply_ascii(colored=True).replace("255 0 0", "0 0 255", 1))
    meshes.surfaces("b.ply")
    assert [*meshes.notes] == ["b.ply: colors of vertices or faces become one, their mean"]


def test_large_textures_are_made_smaller(tmp_path: Path) -> None:
    Image.new("L", (5000, 10), 7).save(tmp_path / "big.png")
    assert library(tmp_path).texture("big.png").shape == (8, 4096, 3)


@pytest.mark.parametrize(("make", "expected"), [
    (lambda: box([1, 2, 3]), 6.0),
    (lambda: sphere(0.5), 4 / 3 * np.pi * 0.125),
    (lambda: cylinder(0.5, 2), np.pi * 0.25 * 2),
    (lambda: capsule(0.5, 2), np.pi * 0.25 * 2 + 4 / 3 * np.pi * 0.125),
    (lambda: capsule(0.5, 0), 4 / 3 * np.pi * 0.125),
])
def test_primitives_are_closed_and_face_outward(make, expected: float) -> None:  # type: ignore[no-untyped-def]
    s = make()
    assert 0.99 * expected < volume(s) <= expected * (1 + 1e-12)
    np.testing.assert_allclose(np.linalg.norm(s.normals, axis=1), 1)
    assert agreement(s) > 0.99 and (s.uv >= 0).all() and (s.uv <= 1).all()
    _, area = face_normals(s.vertices, s.faces)
    assert (area > 0).all()


def test_a_capsule_is_straight_between_its_ends() -> None:
    p = capsule(0.5, 2).vertices
    widest = np.isclose(np.hypot(p[:, 0], p[:, 1]), 0.5)
    np.testing.assert_allclose(np.unique(np.round(p[widest, 2], 9)), [-1, 1])


def test_srgb_is_that_of_the_standard() -> None:
    np.testing.assert_allclose(linear_from_srgb([0, 0.04, 0.5, 1, 2]),
                               [0, 0.0030960, 0.2140411, 1, 1], rtol=1e-5)


def test_visuals_that_look_different_are_not_joined() -> None:
    picture = np.full((2, 2, 3), 5, np.uint8)
    looks = [Material(), Material(emission=(1.0, 0.0, 0.0)), Material(unlit=True),
             Material(alpha_cutoff=0.5), Material(blend=True), Material(texture=picture),
             Material(texture=picture, tiling=("clamp", "repeat")),
             *(Material(maps=Maps(**{kind: picture})) for kind in (
                 "metallic_roughness", "normal", "occlusion", "emission")),
             Material(maps=Maps(normal=picture + 1))]
    solid = box([1, 1, 1])
    visuals = visuals_of_part(0, [replace(solid, material=look) for look in looks * 2])
    assert [v.material for v in visuals] == looks
    assert all(len(v.faces) == 24 for v in visuals)
    same = [Material(), Material(tiling=("clamp", "clamp"))]  # without a picture to tile
    assert len(visuals_of_part(0, [replace(solid, material=look) for look in same])) == 1


@pytest.mark.parametrize("size", [0.0, -1.0, np.nan, np.inf])
def test_primitives_without_size_are_refused(size: float) -> None:
    for make in (lambda: sphere(size), lambda: box([1, size, 1]), lambda: cylinder(size, 1),
                 lambda: cylinder(1, size), lambda: capsule(size, 1)):
        with pytest.raises(ModelError):
            make()


def test_smooth_normals_of_a_sphere_point_outward_and_are_smooth() -> None:
    s = sphere(1.0)
    made = clean_surface(s.vertices, s.faces)
    assert made is not None
    assert np.einsum("vi,vi->v", made.normals, made.vertices).min() > 0.998
    assert len(made.vertices) < len(s.vertices)  # the seam is welded


def test_a_coarse_prism_keeps_its_edges_and_a_fine_one_loses_them() -> None:
    for sides, groups in ((6, 6 * 4), (36, 36 * 2)):
        a = np.arange(sides) * 2 * np.pi / sides
        ring = np.stack([np.cos(a), np.sin(a)], -1)
        v = np.concatenate([np.c_[ring, np.zeros(sides)], np.c_[ring, np.ones(sides)]])
        i, j = np.arange(sides), (np.arange(sides) + 1) % sides
        f = np.concatenate([np.c_[i, j, j + sides], np.c_[i, j + sides, i + sides]])
        group, normals = smooth_corners(v, f)
        assert len(normals) == groups == group.max() + 1


def test_normals_do_not_depend_on_how_a_quad_was_cut() -> None:
    """The corner of a cube with every edge smooth points along the diagonal."""
    s = box([1, 1, 1])
    faces = s.faces.copy()
    faces[:2] = [[1, 2, 3], [1, 3, 0]]  # one side along its other diagonal
    group, normals = smooth_corners(s.vertices, faces, crease=np.pi)
    corners = s.vertices[faces]
    np.testing.assert_allclose(normals[group], corners * 2 / np.sqrt(3), atol=1e-12)


def test_valid_normals_are_kept_and_bad_ones_are_not() -> None:
    tilted = np.tile([0.0, 0.6, 0.8], (3, 1))
    triangle = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    kept = clean_surface(triangle, [[0, 1, 2]], normals=tilted * 7)
    assert kept is not None
    np.testing.assert_allclose(kept.normals, tilted)
    for bad in (np.zeros((3, 3)), np.full((3, 3), np.nan), -tilted, tilted[:2]):
        made = clean_surface(triangle, [[0, 1, 2]], normals=bad)
        assert made is not None
        np.testing.assert_allclose(made.normals, np.tile([0.0, 0.0, 1.0], (3, 1)))


def test_degenerate_triangles_and_lonely_vertices_go() -> None:
    v = [[9, 9, 9], [0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0]]
    made = clean_surface(v, [[1, 2, 3], [1, 1, 2], [1, 2, 4]])
    assert made is not None and len(made.faces) == 1 and made.vertices.max() == 1
    assert clean_surface(v, [[1, 2, 4]]) is None


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e300])
def test_vertices_that_are_no_numbers_are_refused(bad: float) -> None:
    with pytest.raises(ModelError):
        clean_surface([[0, 0, 0], [1, 0, 0], [0, bad, 0]], [[0, 1, 2]])


def test_indices_out_of_range_are_refused() -> None:
    with pytest.raises(ModelError, match="does not exist"):
        clean_surface(TETRA, [[0, 1, 4]])


@pytest.mark.parametrize("scale", [(2, 2, 2), (1, 2, 3), (-1, 1, 1), (-1, -2, -3), (1, -1, -1)])
def test_scaled_and_mirrored_surfaces_stay_right_side_out(scale: tuple[float, ...]) -> None:
    s = sphere(1.0)
    out = move_surface(s, np.eye(4), scale)
    np.testing.assert_allclose(volume(out), volume(s) * abs(np.prod(scale)))
    normals = s.vertices / np.square(scale) * scale  # of an ellipsoid, in the frame of the sphere
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    np.testing.assert_allclose(out.normals, normals, atol=1e-12)
    assert agreement(out) > 0.9


def test_a_scale_of_zero_is_refused() -> None:
    with pytest.raises(ModelError, match="zero"):
        move_surface(sphere(1.0), np.eye(4), (1, 0, 1))


def test_visuals_of_equal_material_are_joined() -> None:
    red, blue = Material("a", (1, 0, 0, 1)), Material("b", (0, 0, 1, 1))
    texture = np.full((2, 2, 3), 5, np.uint8)
    looks = [red, blue, Material("other name", (1, 0, 0, 1)), Material(texture=texture),
             Material(texture=texture.copy()), Material(texture=texture + 1)]
    surfaces = [TriangleSurface(b.vertices + i, b.faces, b.normals, b.uv, look)
                for i, look in enumerate(looks) for b in [box([1, 1, 1])]]
    visuals = visuals_of_part(3, surfaces)
    assert [len(v.faces) for v in visuals] == [24, 12, 24, 12]
    assert all(v.part == 3 and v.faces.dtype == np.int32 for v in visuals)
    v = visuals[0]
    np.testing.assert_allclose(v.vertices[v.faces[12:]].mean((0, 1)), [2, 2, 2])
