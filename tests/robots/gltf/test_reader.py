"""glTF models: nodes, skins, morphs, animations, against closed forms and a second reader."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from gcbench.robots.catalog import load_robot
from gcbench.robots.gltf.meshes import dominant_bones, triangles_of
from gcbench.robots.gltf.reader import load_gltf
from gcbench.robots.model import ArticulatedModel, ModelState, deform_visual, forward_kinematics
from gcbench.robots.motion.trajectory import default_scored_joints
from scipy.spatial import cKDTree

from ...support.gltf_maker import CORNERS, CUBE, Maker, bar, bent_bar
from ...support.independent_gltf import IndependentGltf

Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def corners(model: ArticulatedModel, posture: ModelState, t: int) -> np.ndarray:
    """[F 3 3] world corners of all triangles at instant t."""
    stretch = None if posture.stretch is None else posture.stretch[t]
    return np.concatenate([
        deform_visual(v, posture.world_from_part[t], stretch, posture.morph[t])[0][v.faces]
        for v in model.visuals])


def at_rest(model: ArticulatedModel) -> np.ndarray:
    poses = forward_kinematics(model, np.zeros(len(model.joint_names)))
    return corners(model, ModelState(poses[None], None, model.morph_weights[None]), 0)


def distance(a: np.ndarray, b: np.ndarray) -> float:
    """Between two sets of triangles [F 3 3], in any order: of corners and of centers, both ways."""
    pairs = [(a.reshape(-1, 3), b.reshape(-1, 3)), (a.mean(1), b.mean(1))]
    return max(float(cKDTree(x).query(y)[0].max()) for pair in pairs for x, y in (pair, pair[::-1]))


def compare(path: Path, times: int = 20) -> tuple[ArticulatedModel, float]:
    """The model, and its worst distance from the second reader's, over rest and all animations."""
    model, other = load_gltf(path), IndependentGltf(path)
    worst = 0.0

    def check(ours: np.ndarray, theirs: np.ndarray) -> None:
        nonlocal worst
        theirs = theirs @ Z_UP.T
        size = float(np.linalg.norm(np.ptp(theirs.reshape(-1, 3), axis=0)))
        assert len(ours) == len(theirs)
        worst = max(worst, distance(ours, theirs) / size)

    check(at_rest(model), other.triangles(None, 0.0))
    rng = np.random.default_rng(0)
    for number, animation in enumerate(model.animations):
        moments = rng.uniform(-0.1, 1.1, times) * animation.duration
        posture = animation.at(moments)
        turn = posture.world_from_part[..., :3, :3]
        np.testing.assert_allclose(turn @ np.swapaxes(turn, -1, -2), np.broadcast_to(
            np.eye(3), turn.shape), atol=1e-9)
        assert np.linalg.det(turn).min() > 0
        for t, moment in enumerate(moments):
            check(corners(model, posture, t), other.triangles(number, float(moment)))
    return model, worst


# -- skins -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["m.glb", "m.gltf"])
def test_a_bar_bends_as_its_closed_form(tmp_path: Path, name: str) -> None:
    maker = Maker()
    _, tip, _ = bent_bar(maker)
    half = np.sin(np.pi / 4)
    maker.animate([(tip, "rotation", [0, 2], [[0, 0, 0, 1], [0, 0, half, half]], "LINEAR")])
    model = load_robot(maker.save(tmp_path, name))
    assert model.part_names == ("scene", "base", "tip")
    (animation,) = model.animations
    assert (animation.name, animation.duration) == ("animation_0", 2.0)
    posture = animation.at(np.array([-1.0, 0.0, 1.0, 2.0, 3.0]))
    points, _, up = bar(maker)
    upper = np.clip((up - 0.25) / 0.5, 0.0, 1.0)[:, None]
    for t, angle in enumerate(np.radians([0.0, 0.0, 45.0, 90.0, 90.0])):
        c, s = np.cos(angle), np.sin(angle)
        x, y, z = points.T - np.array([[0.0], [1.0], [0.0]])
        turned = np.stack([c * x - s * y, s * x + c * y + 1.0, z], 1)
        wanted = ((1 - upper) * points + upper * turned) @ Z_UP.T
        got = corners(model, posture, t).reshape(-1, 3)
        distance = np.linalg.norm(got[:, None] - wanted[None], axis=2).min(1)
        assert distance.max() < 1e-6
    assert posture.stretch is None  # nothing is scaled
    # the mask shows the bone that a face follows most: the bar's middle is where that changes
    for visual in model.visuals:
        rest = deform_visual(visual, forward_kinematics(model, np.zeros(1)), None, np.zeros(0))[0]
        middle = rest[visual.faces][..., 2].mean(1)
        assert np.all(middle < 1.1) if visual.part == 1 else np.all(middle > 0.9)


def test_bones_get_joints_that_bend_them(tmp_path: Path) -> None:
    maker = Maker()
    bent_bar(maker)
    model = load_gltf(maker.save(tmp_path))
    assert model.joint_names == ("tip",) and model.joint_types == ("revolute",)
    assert abs(model.screw[2, 1]) < 1e-9  # perpendicular to the bone, which is along y
    assert default_scored_joints(model) == ("tip",)
    low, high = model.limits[0]
    assert low == -high and 0.3 < high < 1.0
    state = ModelState(forward_kinematics(model, [[high]]), None, np.zeros((1, 0)))
    moved = corners(model, state, 0)
    still = at_rest(model)
    below = still[..., 2].max(1) < 0.5 - 1e-9  # all weight on the base
    np.testing.assert_allclose(moved[below], still[below], atol=1e-12)
    assert np.abs(moved - still).max() > 0.3


def test_skins_nested_shared_and_outside_of_the_scene(tmp_path: Path) -> None:
    maker = Maker()
    rng = np.random.default_rng(1)
    points, faces, _ = bar(maker)
    above = maker.node(translation=[1, 2, 3], rotation=[0.5, 0.5, 0.5, 0.5], scale=[2, 2, 2])
    bones = [maker.node(above, translation=rng.normal(size=3).tolist())]
    for _ in range(4):
        bones.append(maker.node(bones[-1], translation=rng.normal(size=3).tolist(),
                                rotation=[0.0, 0.6, 0.0, 0.8], scale=[1.0, 0.5, 1.5]))
    joints = [rng.integers(0, 5, (len(points), 4)) for _ in range(2)]
    weights = rng.random((len(points), 8))
    weights /= weights.sum(1, keepdims=True) / 65535.0
    fields = {f"JOINTS_{k}": maker.accessor(joints[k], "B") for k in range(2)}
    fields |= {f"WEIGHTS_{k}": maker.accessor(np.round(weights[:, 4 * k:4 * k + 4]), "H",
                                              normalized=True) for k in range(2)}
    mesh = maker.mesh(points, faces, **fields)
    binds = rng.normal(size=(5, 4, 4))
    binds[:, 3] = [0, 0, 0, 1]
    first, second = maker.skin(bones, binds), maker.skin(bones[::-1])
    nodes = [maker.node(mesh=mesh, skin=first), maker.node(mesh=mesh, skin=second, scale=[9, 9, 9])]
    maker.scene(*nodes)  # the bones are not in it
    turns = rng.normal(size=(6, 4))
    maker.animate([
        (bones[1], "rotation", np.arange(6.0), turns / np.linalg.norm(turns, axis=1)[:, None],
         "LINEAR"),
        (bones[2], "scale", [1.0, 4.0], [[1, 1, 1], [0.2, 3.0, -1.0]], "LINEAR"),
        (above, "translation", [0.5, 1.0], [[0, 0, 0], [1, 1, 1]], "STEP")], name="all of it")
    model, worst = compare(maker.save(tmp_path))
    assert worst < 1e-7
    assert model.animations[0].name == "all of it"
    assert len(model.part_names) == 7
    assert len({v.part for v in model.visuals}) >= 4
    for visual in model.visuals:
        assert visual.skin is not None
        np.testing.assert_allclose(visual.skin.weight.sum(1), 1.0, atol=1e-12)


def test_the_dominant_bone_is_that_of_the_largest_sum() -> None:
    rng = np.random.default_rng(3)
    bone, weight = rng.integers(0, 7, (30, 4)), rng.random((30, 4))
    faces = rng.integers(0, 30, (50, 3))
    found = dominant_bones(faces, bone, weight, 7)
    for face, chosen in zip(faces, found, strict=True):
        sums = np.zeros(7)
        for vertex in face:
            for k in range(4):
                sums[bone[vertex, k]] += weight[vertex, k]
        assert sums[chosen] == pytest.approx(sums.max(), abs=2e-6)


# -- nodes and animations --------------------------------------------------------------------


def test_rigid_animation_of_nodes_is_rigid(tmp_path: Path) -> None:
    maker = Maker()
    mesh = maker.mesh()
    body = maker.node(mesh=mesh, scale=[4, 1, 2], name="truck")
    other = maker.node(name="axle", translation=[1, 0, 0])
    wheel = maker.node(other, mesh=mesh, name="wheel", scale=[0.5, -0.5, 0.5])
    maker.scene(body, other)
    maker.animate([(other, "rotation", [0, 1], [[0, 0, 0, 1], [0, 0, 1, 0]], "LINEAR"),
                   (wheel, "scale", [0, 1], [[0.5, -0.5, 0.5]] * 2, "LINEAR")])
    model, worst = compare(maker.save(tmp_path))
    assert worst < 1e-7
    assert not any(v.deforms for v in model.visuals)
    assert model.animations[0].at(np.array([0.5])).stretch is None
    assert "wheel" in model.part_names and "axle" in model.joint_names


@pytest.mark.parametrize("scale", [[[1, 1, 1], [3, 0.5, 1]], [[1, 1, 1], [-1, 1, 1]],
                                   [[0, 0, 0], [2, 2, 2]]])
def test_scale_that_changes_is_a_stretch(tmp_path: Path, scale: list[list[float]]) -> None:
    maker = Maker()
    mesh = maker.mesh()
    first = maker.node(mesh=mesh, scale=scale[0], rotation=[0.0, 0.6, 0.0, 0.8])
    maker.node(first, mesh=mesh, rotation=[0.6, 0.0, 0.0, 0.8], translation=[0, 2, 0])
    maker.scene(first, maker.node(mesh=mesh, translation=[3, 0, 0]))
    maker.animate([(first, "scale", [0, 1], scale, "LINEAR")])
    model, worst = compare(maker.save(tmp_path))
    assert worst < 2e-6
    assert [v.deforms for v in model.visuals] == [True, True, False]


def test_rotation_under_an_uneven_scale_shears(tmp_path: Path) -> None:
    maker = Maker()
    above = maker.node(scale=[1, 3, 1])
    maker.node(above, mesh=maker.mesh())
    maker.scene(above)
    maker.animate([(1, "rotation", [0, 1], [[0, 0, 0, 1], [0, 0, 1, 0]], "LINEAR")])
    model, worst = compare(maker.save(tmp_path))
    assert worst < 1e-7 and model.visuals[0].deforms


def test_cubic_splines_are_hermite_and_steps_hold(tmp_path: Path) -> None:
    maker = Maker()
    mesh = maker.mesh()
    a, b = maker.node(mesh=mesh), maker.node(mesh=mesh)
    maker.scene(a, b)
    # (in-tangent, value, out-tangent) of keys at 1 s and 3 s
    keys = [[9, 9, 9], [0, 0, 0], [1, 0, 0], [0, 2, 0], [4, 0, 0], [9, 9, 9]]
    maker.animate([(a, "translation", [1, 3], keys, "CUBICSPLINE"),
                   (b, "translation", [1, 2, 3], [[1, 0, 0], [2, 0, 0], [3, 0, 0]], "STEP")])
    model, worst = compare(maker.save(tmp_path))
    assert worst < 1e-7
    times = np.array([0.0, 1.0, 1.5, 1.999, 2.0, 2.5, 3.0, 4.0])
    poses = model.animations[0].at(times).world_from_part
    t = np.clip((times - 1) / 2, 0, 1)
    x = 2 * (t**3 - 2 * t**2 + t) + 4 * (3 * t**2 - 2 * t**3)
    y = 2 * 2 * (t**3 - t**2)
    np.testing.assert_allclose(poses[:, 1, :3, 3], np.stack([x, 0 * x, y], 1), atol=1e-6)
    np.testing.assert_allclose(poses[:, 2, 0, 3], [1, 1, 1, 1, 2, 2, 3, 3])


def test_several_animations_have_names(tmp_path: Path) -> None:
    maker = Maker()
    node = maker.node(mesh=maker.mesh())
    for k, name in enumerate(["run", "", "run"]):
        maker.animate([(node, "translation", [0, 1 + k], [[0, 0, 0], [1, 0, 0]], "LINEAR")],
                      **({"name": name} if name else {}))
    model = load_gltf(maker.save(tmp_path))  # no scene: every root is drawn
    assert [a.name for a in model.animations] == ["run", "animation_1", "run_2"]
    assert [a.duration for a in model.animations] == [1.0, 2.0, 3.0]


def test_transforms_and_instances(tmp_path: Path) -> None:
    maker = Maker()
    rng = np.random.default_rng(5)
    mesh = maker.mesh()
    matrix = np.eye(4)
    matrix[:3] = rng.normal(size=(3, 4))
    above = maker.node(matrix=matrix.T.ravel().tolist())
    for scale in ([1, 1, -1], [2, 3, 4], [1, 0, 1]):
        maker.node(above, mesh=mesh, scale=scale, translation=rng.normal(size=3).tolist(),
                   rotation=[0.5, -0.5, 0.5, 0.5])
    maker.node(mesh=mesh, scale=[0, 0, 0])
    model, worst = (load_gltf(maker.save(tmp_path)), 0.0)
    assert "nodes of scale zero are not drawn" in model.notes
    del maker.tree["nodes"][4]
    model, worst = compare(maker.save(tmp_path))
    assert worst < 2e-6
    # outward stays outward, whatever mirrors
    for visual in model.visuals[:2]:
        p = visual.vertices[visual.faces]
        assert np.einsum("fi,fi->", p[:, 0], np.cross(p[:, 1], p[:, 2])) > 0
        flat = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        assert np.einsum("fci,fi->fc", visual.normals[visual.faces], flat).min() > 0


# -- meshes ----------------------------------------------------------------------------------


def test_strips_and_fans() -> None:
    index = np.arange(5)
    assert triangles_of(index, 5).tolist() == [[0, 1, 2], [1, 3, 2], [2, 3, 4]]
    assert triangles_of(index, 6).tolist() == [[1, 2, 0], [2, 3, 0], [3, 4, 0]]
    assert triangles_of(index, 4).tolist() == [[0, 1, 2]]
    assert len(triangles_of(index[:2], 5)) == len(triangles_of(index[:2], 6)) == 0


@pytest.mark.parametrize("mode", [5, 6])
def test_strips_and_fans_are_drawn(tmp_path: Path, mode: int) -> None:
    maker = Maker()
    flat = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0.2, 1.4, 0], [-0.5, 0.5, 0]]
    maker.node(mesh=maker.mesh(flat, np.arange(5), primitive={"mode": mode}))
    model, worst = compare(maker.save(tmp_path))
    assert worst < 1e-7 and sum(len(v.faces) for v in model.visuals) == 3


def test_points_and_lines_are_noted(tmp_path: Path) -> None:
    maker = Maker()
    maker.node(mesh=maker.mesh())
    maker.node(mesh=maker.mesh(primitive={"mode": 1}))
    assert "points and lines are not drawn" in load_gltf(maker.save(tmp_path)).notes


def test_sparse_strided_normalised_and_absent_views(tmp_path: Path) -> None:
    maker = Maker()
    # 16-bit positions, 8 bytes each, of which every other element is another attribute's
    packed = np.zeros((8, 2, 4), "<i2")
    packed[:, 0, :3] = CORNERS * 32767
    packed[:, 1, :3] = -1
    view = maker.view(packed.tobytes(), byteStride=16)
    maker.tree["extensionsRequired"] = maker.tree["extensionsUsed"] = ["KHR_mesh_quantization"]
    moved = maker.view(np.array([7], "B").tobytes()), maker.view(
        np.array([[32767, 32767, -32767]], "<i2").tobytes())
    points = maker.add(
        "accessors", bufferView=view, componentType=5122, normalized=True, count=8, type="VEC3",
        sparse={"count": 1, "indices": {"bufferView": moved[0], "componentType": 5121},
                "values": {"bufferView": moved[1]}})
    zeros = maker.add("accessors", componentType=5126, count=8, type="VEC3", sparse={
        "count": 2, "indices": {"bufferView": maker.view(np.array([1, 3], "<u2").tobytes()),
                                "componentType": 5123},
        "values": {"bufferView": maker.view(np.array([[0, 0, 1], [0, 0, 2]], "<f4").tobytes())}})
    primitive = {"attributes": {"POSITION": points}, "targets": [{"POSITION": zeros}],
                 "indices": maker.accessor(CUBE.ravel(), "B")}
    maker.node(mesh=maker.add("meshes", primitives=[primitive], weights=[0.5]))
    model, worst = compare(maker.save(tmp_path))
    assert worst < 1e-7
    corner = model.visuals[0].vertices.min(0)
    np.testing.assert_allclose(corner, [0, 0, -1], atol=1e-9)  # the sparse one, moved out


def test_morphs_with_skin_and_animation(tmp_path: Path) -> None:
    maker = Maker()
    rng = np.random.default_rng(2)
    _, tip, body = bent_bar(maker)
    count = maker.tree["accessors"][0]["count"]
    mesh = maker.tree["meshes"][0]
    mesh["primitives"][0]["targets"] = [
        {"POSITION": maker.accessor(0.1 * rng.normal(size=(count, 3)))} for _ in range(3)]
    mesh["weights"] = [0.0, 0.0, 0.25]
    maker.tree["nodes"][body]["weights"] = [1.0, 0.0, 0.5]  # the node's come first
    half = np.sin(np.pi / 4)
    maker.animate([
        (body, "weights", [0, 1, 2], rng.random(9), "LINEAR"),
        (tip, "rotation", [0, 2], [[0, 0, 0, 1], [0, 0, half, half]], "LINEAR")])
    maker.animate([(body, "weights", [0, 1], rng.random(18), "CUBICSPLINE")])
    model, worst = compare(maker.save(tmp_path))
    assert worst < 1e-7
    np.testing.assert_array_equal(model.morph_weights, [1.0, 0.0, 0.5])
    assert model.animations[1].at(np.array([0.3, 0.6])).morph.shape == (2, 3)


@pytest.mark.parametrize("normals", [False, True])
def test_what_is_flat_at_rest_opens(tmp_path: Path, normals: bool) -> None:
    """A flap that is folded to a line, and opens to a square."""
    maker = Maker()
    flat = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 0], [0, 0, 0]], float)
    opened = maker.accessor([[0, 0, 0], [0, 0, 0], [0, 1, 0], [0, 1, 0]])
    attributes = {"NORMAL": maker.accessor(np.tile([0.0, 0, 1], (4, 1)))} if normals else {}
    flap = maker.node(mesh=maker.mesh(flat, [[0, 1, 2], [0, 2, 3]], [{"POSITION": opened}],
                                      **attributes))
    maker.node(mesh=maker.mesh())
    maker.animate([(flap, "weights", [0.0, 1.0], [0.0, 1.0], "LINEAR")])
    model = load_gltf(maker.save(tmp_path))
    assert [len(v.faces) for v in model.visuals] == [2, 12]
    posture = model.animations[0].at(np.array([1.0]))
    vertices, turned = deform_visual(model.visuals[0], posture.world_from_part[0], None,
                                     posture.morph[0])
    np.testing.assert_allclose(np.ptp(vertices, axis=0), [1, 0, 1], atol=1e-9)
    np.testing.assert_allclose(turned, np.tile(Z_UP @ [0, 0, 1], (len(vertices), 1)), atol=1e-9)


def test_morph_normals_follow(tmp_path: Path) -> None:
    """A quad that a morph tilts: its normal tilts with it, given or made."""
    flat = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    faces, tilt = [[0, 1, 2], [0, 2, 3]], np.array([[0, 0, 0], [0, 0, 1], [0, 0, 1], [0, 0, 0]])
    for given in (True, False):
        maker = Maker()
        target = {"POSITION": maker.accessor(tilt)}
        fields = {}
        if given:
            fields["NORMAL"] = maker.accessor(np.tile([0.0, 0, 1], (4, 1)))
            target["NORMAL"] = maker.accessor(np.tile([-1.0, 0, 0], (4, 1)))
        maker.node(mesh=maker.mesh(flat, faces, [target], {"weights": [1.0]}, **fields))
        model = load_gltf(maker.save(tmp_path))
        (visual,) = model.visuals
        poses = forward_kinematics(model, np.zeros(1))
        _, normals = deform_visual(visual, poses, None, model.morph_weights)
        np.testing.assert_allclose(
            normals, np.tile(np.array([-1, 0, 1]) / 2**0.5 @ Z_UP.T, (4, 1)), atol=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_files_of_everything_at_once(tmp_path: Path, seed: int) -> None:
    """Random trees of scaled, mirrored and sheared nodes with skins, morphs, all kinds of keys."""
    rng = np.random.default_rng(seed)
    maker = Maker()

    def turns(count: int) -> np.ndarray:
        q = rng.normal(size=(count, 4))
        return q / np.linalg.norm(q, axis=1, keepdims=True)

    nodes: list[int] = []
    for k in range(10):
        parent = None if k == 0 else int(rng.integers(k))
        if rng.random() < 0.2:
            matrix = np.eye(4)
            matrix[:3] = rng.normal(size=(3, 4))
            nodes.append(maker.node(parent, matrix=matrix.T.ravel().tolist()))
        else:
            nodes.append(maker.node(
                parent, translation=rng.normal(size=3).tolist(), rotation=turns(1)[0].tolist(),
                scale=(rng.uniform(0.5, 2, 3) * rng.choice([1, 1, -1], 3)).tolist()))
    points, faces, _ = bar(maker)
    targets = [{"POSITION": maker.accessor(rng.normal(size=points.shape))} for _ in range(2)]
    joints = rng.permutation(10)[:4].tolist()
    fields = {"JOINTS_0": maker.accessor(rng.integers(0, 4, (len(points), 4)), "B"),
              "WEIGHTS_0": maker.accessor(rng.random((len(points), 4)))}
    maker.node(0, mesh=maker.mesh(points, faces, targets, **fields),
               skin=maker.skin(joints, [np.diag([*rng.uniform(0.5, 1, 3), 1]) for _ in joints]))
    plain, soft = maker.mesh(), maker.mesh(points, faces, targets)
    for k in (3, 6, 9):
        maker.tree["nodes"][k]["mesh"] = soft if k == 6 else plain
    for how in ("LINEAR", "STEP", "CUBICSPLINE"):
        each = 3 if how == "CUBICSPLINE" else 1
        tracks = [(6, "weights", [0.0, 1.0], rng.normal(size=4 * each), how)]
        for k in (0, 1, 4, 7):
            if "matrix" not in maker.tree["nodes"][k]:
                path = str(rng.choice(["translation", "rotation", "scale"]))
                keys = turns(3 * each) if path == "rotation" else rng.normal(size=(3 * each, 3))
                tracks.append((k, path, np.sort(rng.random(3)), keys, how))
        maker.animate(tracks)
    _, worst = compare(maker.save(tmp_path), times=6)
    assert worst < 1e-6


# -- what a model is told --------------------------------------------------------------------


def test_joints_of_a_hierarchy_of_meshes(tmp_path: Path) -> None:
    maker = Maker()
    beam = CORNERS * [0.2, 2.0, 0.2] - [0.1, 0.0, 0.1]
    mesh = maker.mesh(beam)
    above = maker.node(mesh=mesh, name="base")
    first = above
    for k in range(3):
        above = maker.node(above, mesh=mesh, name=f"link{k}", translation=[0, 2, 0])
    maker.scene(first)
    model = load_gltf(maker.save(tmp_path))
    assert model.joint_names == ("link0", "link1", "link2")
    assert default_scored_joints(model) == model.joint_names
    for p in model.joint_child:
        axis = model.screw[p, :3]
        assert np.linalg.norm(axis) == pytest.approx(1.0) and abs(axis[1]) < 1e-9
        assert not model.screw[p, 3:].any()


def test_a_single_mesh_turns_about_the_vertical(tmp_path: Path) -> None:
    maker = Maker()
    maker.node(mesh=maker.mesh(), translation=[3, 1, 2], rotation=[0.6, 0.0, 0.0, 0.8])
    model = load_gltf(maker.save(tmp_path))
    turned = forward_kinematics(model, np.array([[0.0], [0.7]]))
    before, after = (corners(model, ModelState(turned, None, np.zeros((2, 0))), t) for t in (0, 1))
    middle = (before.reshape(-1, 3).min(0) + before.reshape(-1, 3).max(0)) / 2
    c, s = np.cos(0.7), np.sin(0.7)
    wanted = (before - middle) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + middle
    np.testing.assert_allclose(after, wanted, atol=1e-9)


def test_units_names_and_provenance(tmp_path: Path) -> None:
    maker = Maker()
    mesh = maker.mesh(CORNERS * 50000.0)
    for name in ("a", "a", "", "b\nc"):
        maker.node(mesh=mesh, name=name)
    maker.tree["asset"] |= {"copyright": "2020 A. Nyone", "extras": {"license": "CC-BY-4.0"}}
    model = load_gltf(maker.save(tmp_path, "big.glb"))
    assert model.part_names == ("scene", "a", "a_2", "node_2", "b_c")
    assert (model.name, model.source, model.licence) == ("big", "big.glb", "CC-BY-4.0")
    assert len(model.sha256) == 64
    extent = np.ptp(at_rest(model).reshape(-1, 3), axis=0)
    np.testing.assert_allclose(extent, 0.5)
    assert any("m large" in note for note in model.notes)


def test_loading_twice_is_the_same(tmp_path: Path) -> None:
    maker = Maker()
    bent_bar(maker)
    path = maker.save(tmp_path)
    a, b = load_gltf(path), load_gltf(path)
    assert a.part_names == b.part_names
    np.testing.assert_array_equal(at_rest(a), at_rest(b))


def test_a_child_that_its_scene_lists_is_drawn_once(tmp_path: Path) -> None:
    maker = Maker()
    top = maker.node(translation=[0, 1, 0])
    child = maker.node(top, mesh=maker.mesh())
    maker.node(top, mesh=0)
    maker.scene(child, top)
    model = load_gltf(maker.save(tmp_path))
    assert len(model.visuals) == 2
    assert f"its scene lists nodes[{child}], the child of another node" in model.notes
    poses = forward_kinematics(model, np.zeros(len(model.joint_names)))
    np.testing.assert_allclose(poses[-1, :3, 3], [0, 0, 1])
    maker.tree["scenes"][0]["nodes"] = [child]  # alone: where its parent puts it
    model = load_gltf(maker.save(tmp_path))
    assert len(model.visuals) == 1
    poses = forward_kinematics(model, np.zeros(len(model.joint_names)))
    np.testing.assert_allclose(poses[model.visuals[0].part, :3, 3], [0, 0, 1])


def test_a_scale_multiplies_all_lengths(tmp_path: Path) -> None:
    maker = Maker()
    _, tip, _ = bent_bar(maker)
    maker.animate([(tip, "translation", [0, 1], [[0, 1, 0], [0, 2, 0]], "LINEAR")])
    path = maker.save(tmp_path)
    one, other = load_gltf(path), load_robot(path, scale=0.1)
    times = np.array([0.0, 0.5])
    a, b = one.animations[0].at(times), other.animations[0].at(times)
    np.testing.assert_allclose(b.world_from_part[..., :3, 3], 0.1 * a.world_from_part[..., :3, 3],
                               atol=1e-12)
    for v, w in zip(one.visuals, other.visuals, strict=True):
        p, _ = deform_visual(v, a.world_from_part[1], None, one.morph_weights)
        q, _ = deform_visual(w, b.world_from_part[1], None, other.morph_weights)
        np.testing.assert_allclose(q, 0.1 * p, atol=1e-12)
