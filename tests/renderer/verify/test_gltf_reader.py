"""The verifier reads the frames of glTF nodes as the loader does, with another parser."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gcbench.errors import ModelError
from gcbench.renderer.generate import render_sequence
from gcbench.renderer.scene.config import RenderConfig
from gcbench.renderer.types import Sequence
from gcbench.renderer.verify.gltf_reader import read_gltf_frames
from gcbench.renderer.verify.kinematics import verify_state
from gcbench.robots.gltf import load_gltf
from gcbench.robots.model import forward_kinematics
from hypothesis import given, settings
from hypothesis import strategies as st

from ...support.gltf_maker import Maker

NUMBER = st.floats(-2, 2).map(lambda x: round(x, 3))
SCALE = st.sampled_from((0.5, 1.0, 1.0, 2.0))


@st.composite
def trees(draw: st.DrawFn) -> Maker:
    """A tree of up to 6 nodes with meshes, with every way of writing a transform."""
    maker = Maker()
    mesh = maker.mesh()
    for n in range(draw(st.integers(1, 6))):
        fields: dict[str, object] = {"mesh": mesh}
        if draw(st.booleans()):
            fields["name"] = f"part {n}"
        fields["translation"] = [draw(NUMBER) for _ in range(3)]
        if draw(st.booleans()):
            fields["rotation"] = [draw(NUMBER), draw(NUMBER), draw(NUMBER), 2.5]
        if draw(st.booleans()):
            fields["scale"] = [draw(SCALE) for _ in range(3)]
        if draw(st.integers(0, 4)) == 0:
            turn = np.linalg.qr(np.random.default_rng(n).normal(size=(3, 3)))[0]
            matrix = np.eye(4)
            matrix[:3, :3] = turn * np.linalg.det(turn) * 1.5
            matrix[:3, 3] = fields["translation"]
            fields = {"mesh": mesh, "matrix": matrix.T.ravel().tolist()}
        maker.node(draw(st.integers(0, n - 1)) if n and draw(st.booleans()) else None, **fields)
    return maker


@settings(max_examples=40, deadline=None)
@given(maker=trees(), suffix=st.sampled_from((".glb", ".gltf")))
def test_both_readers_agree(
    maker: Maker, suffix: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = maker.save(tmp_path_factory.mktemp("gltf"), f"m{suffix}")
    model = load_gltf(path)
    poses = forward_kinematics(model, np.zeros(len(model.joint_names)))
    frames = read_gltf_frames(path)
    for name, pose in zip(model.part_names[1:], poses[1:], strict=True):
        np.testing.assert_allclose(pose[:3, 3], frames[name].position, atol=1e-9)
        np.testing.assert_allclose(pose[:3, :3], frames[name].rotation, atol=1e-9)


@pytest.fixture(scope="module")
def lamp(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A base with two arms, one on the other, in centimetres."""
    maker = Maker()
    mesh = maker.mesh()
    base = maker.node(mesh=mesh, name="base", scale=[0.01] * 3)
    arm = maker.node(base, mesh=mesh, name="arm", translation=[0, 40, 5],
                     rotation=[0, 0, 0.6, 0.8])
    maker.node(arm, mesh=mesh, name="head", translation=[3, 50, 0])
    maker.scene(base)
    return maker.save(tmp_path_factory.mktemp("lamp"), "lamp.glb")


@pytest.fixture(scope="module")
def sequence(lamp: Path) -> Sequence:
    config = RenderConfig(robot=str(lamp), frames=5, width=64, height=48)
    return render_sequence(config, 0)


def _rest(sequence: Sequence, file: Path, scale: float = 1.0) -> dict[str, bool]:
    checks = verify_state(sequence, None, file, scale=scale)
    return {c.name: c.ok for c in checks if "glTF" in c.name}


@pytest.mark.gl
def test_a_right_sequence_passes(sequence: Sequence, lamp: Path) -> None:
    found = _rest(sequence, lamp)
    assert len(found) == 2 and all(found.values())
    assert np.ptp(sequence.state.joint_positions, axis=0).max() > 0.1


@pytest.mark.gl
@pytest.mark.parametrize("name", ["scene", "the\tbase", "x" * 120])
def test_a_name_that_the_loader_changes_is_no_failure(tmp_path: Path, name: str) -> None:
    maker = Maker()
    mesh = maker.mesh()
    base = maker.node(mesh=mesh, name=name, translation=[1, 2, 3])
    arm = maker.node(base, mesh=mesh, name="arm", translation=[0, 4, 1])
    maker.node(arm, mesh=mesh, name="head", translation=[0, 0.5, 0])
    maker.scene(base)
    file = maker.save(tmp_path)
    made = render_sequence(RenderConfig(robot=str(file), frames=2, width=64, height=48), 0)
    assert name not in made.meta.part_names[1:]
    found = _rest(made, file)
    assert len(found) == 2 and all(found.values())


@pytest.mark.gl
@pytest.mark.parametrize(("part", "field"), [(1, (0, 3)), (2, (1, 3))])
def test_a_part_out_of_place_is_found(
    sequence: Sequence, lamp: Path, part: int, field: tuple[int, int]
) -> None:
    poses = sequence.state.world_from_part.copy()
    poses[2, part][field] += 1e-4
    wrong = replace(sequence, state=replace(sequence.state, world_from_part=poses))
    assert not _rest(wrong, lamp)["rest poses from the glTF file: position"]


@pytest.mark.gl
def test_another_file_is_found(sequence: Sequence, lamp: Path, tmp_path: Path) -> None:
    other = tmp_path / "lamp.glb"
    data = lamp.read_bytes()
    other.write_bytes(data.replace(b"[0, 40, 5]", b"[0, 41, 5]"))
    assert data != other.read_bytes()
    assert not _rest(sequence, other)["rest poses from the glTF file: position"]


def test_a_file_that_is_no_gltf_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.gltf"
    path.write_text('{"nodes": 3}')
    with pytest.raises(ModelError, match=r"m\.gltf"):
        read_gltf_frames(path)


@pytest.mark.gl
def test_a_file_without_a_second_reader_is_not_read(sequence: Sequence, tmp_path: Path) -> None:
    file = tmp_path / "lamp.boxes"
    file.write_text("[]")
    found = verify_state(sequence, None, file)
    assert [c.name for c in found] == [c.name for c in verify_state(sequence)]
