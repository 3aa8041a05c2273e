"""Depth networks of transformers behind `--depth hf:MODEL`: metres, task, licence, messages."""

from __future__ import annotations

import json
import os
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.benchmark.methods.registry import load_method, with_options
from gcbench.gcpose.images.depth import find_depth

torch = pytest.importorskip("torch", reason="networks need PyTorch")
if find_spec("transformers") is None:
    pytest.skip("networks of Hugging Face need transformers", allow_module_level=True)

from gcbench.gcpose.networks.torchvision_raft import import_torchvision  # noqa: E402

if find_spec("torchvision"):
    import_torchvision()
import transformers  # noqa: E402

RGB = np.random.default_rng(0).integers(0, 256, (60, 91, 3)).astype(np.uint8)
CARD = "---\nlicense: apache-2.0\ndatasets:\n- hypersim\n---\nA tiny model.\n"


def save(model: Any, folder: Path) -> None:
    """A tiny network with random weights, and how its images are prepared."""
    torch.manual_seed(0)
    for parameter in model.parameters():
        torch.nn.init.normal_(parameter, std=0.3)
    model.save_pretrained(folder)
    transformers.DPTImageProcessor(
        size={"height": 56, "width": 56}, ensure_multiple_of=14,
        keep_aspect_ratio=model.config.model_type == "depth_anything",
    ).save_pretrained(folder)


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Models of several kinds."""
    root = tmp_path_factory.mktemp("models")
    backbone = transformers.Dinov2Config(
        hidden_size=8, num_hidden_layers=4, num_attention_heads=2, mlp_ratio=1,
        out_indices=[1, 2, 3, 4], reshape_hidden_states=False, image_size=56, patch_size=14)
    for kind in ("metric", "relative"):
        save(transformers.DepthAnythingForDepthEstimation(transformers.DepthAnythingConfig(
            backbone_config=backbone, reassemble_hidden_size=8, neck_hidden_sizes=[4, 4, 4, 4],
            fusion_hidden_size=4, head_hidden_size=4, depth_estimation_type=kind, max_depth=20,
        )), root / kind)
    (root / "metric/README.md").write_text(CARD)
    dpt = transformers.DPTConfig(
        hidden_size=8, num_hidden_layers=4, num_attention_heads=2, intermediate_size=8,
        backbone_out_indices=[0, 1, 2, 3], neck_hidden_sizes=[4, 4, 4, 4], fusion_hidden_size=4,
        image_size=56, patch_size=14)
    save(transformers.DPTForDepthEstimation(dpt), root / "dpt")
    save(transformers.DPTForSemanticSegmentation(dpt), root / "segmenter")
    bert = transformers.BertConfig(hidden_size=8, num_hidden_layers=1, num_attention_heads=1,
                                   intermediate_size=8, vocab_size=9)
    save(transformers.BertModel(bert), root / "bert")
    return root


def predict(folder: Path) -> np.ndarray:
    """What the pipeline of transformers predicts."""
    from PIL import Image

    pipeline = transformers.pipeline("depth-estimation", model=str(folder), device="cpu")
    return pipeline(Image.fromarray(RGB))["predicted_depth"].numpy()


def test_a_metric_network_returns_the_pipeline_s_metres(folders: Path) -> None:
    depth = find_depth(f"hf:{folders}/metric")
    assert depth is not None
    found, expected = depth(RGB), predict(folders / "metric")
    assert found.shape == RGB.shape[:2] and found.dtype == np.float32
    assert np.ptp(expected) > 0.1 and 0 < found.min() < found.max() <= 20
    np.testing.assert_allclose(found, expected, rtol=1e-4)


@pytest.mark.parametrize("kind", ["relative", "dpt"])
def test_a_relative_network_s_output_is_inverse_depth(folders: Path, kind: str) -> None:
    depth = find_depth(f"hf-relative:{folders}/{kind}")
    assert depth is not None
    found, inverse = depth(RGB), predict(folders / kind)
    assert np.isfinite(found).all() and (inverse > 0).any()
    np.testing.assert_array_equal(found > 0, inverse > 0)
    np.testing.assert_allclose((found * inverse)[inverse > 0], 1, rtol=1e-3)


def test_the_row_shows_network_data_and_licence(folders: Path) -> None:
    method = load_method(with_options("gcpose", {"depth": f"hf:{folders}/metric"}))
    assert method.name == "gcpose depth=hf:metric"
    assert method.training == (
        "supervised: masks of synthetic video, for rgb and rgbd-noise; "
        "hypersim (metric; licence apache-2.0); supervised: flow of synthetic video, for rgb")
    method = load_method(with_options("gcpose-depth", {"depth": f"hf-metric:{folders}/dpt"}))
    assert method.name == "gcpose-depth depth=hf-metric:dpt" and "rgb" in method.inputs
    assert method.training.startswith("data not stated (dpt; licence not stated); supervised: flow")


@pytest.mark.parametrize(("name", "said"), [
    ("hf:", "no depth 'hf:'; there are none"),
    ("hf-metrik:x", "perhaps you meant hf-metric:MODEL"),
    ("hf:ROOT/none", "there is no such folder"),
    ("hf:ROOT/relative", "up to a factor and an offset; use a metric model, or hf-relative:"),
    ("hf-metric:ROOT/relative", "says relative depth, not metric"),
    ("hf-relative:ROOT/metric", "says metric depth, not relative"),
    ("hf:ROOT/dpt", "does not say what dpt returns; use hf-metric:"),
    ("hf-metric:ROOT/segmenter", "not the weights of a dpt for depth: head."),
    ("hf:ROOT/bert", "bert estimates no depth; there are"),
    ("hf:ROOT", "transformers cannot load it"),
])
def test_what_cannot_be_used_is_said_in_one_line(folders: Path, name: str, said: str) -> None:
    with pytest.raises(GcbenchError) as caught:
        find_depth(name.replace("ROOT", str(folders)))
    assert said in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.slow
def test_a_model_of_the_hub_without_a_network(tmp_path: Path) -> None:
    """In another process: transformers reads the variable once."""
    import subprocess
    import sys

    code = "from gcbench.gcpose.images.depth import find_depth; find_depth('hf:some/model')"
    environment = {**os.environ, "HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True,
                          text=True, check=False)
    last = done.stderr.splitlines()[-1]
    assert "ConfigError: some/model: transformers cannot load it (" in last


def test_nothing_of_a_model_is_executed(folders: Path, tmp_path: Path) -> None:
    config = json.loads((folders / "metric/config.json").read_text())
    sprung = tmp_path / "sprung"

    class Trap:
        def __reduce__(self) -> tuple[object, ...]:
            return os.mkdir, (str(sprung),)

    def model(name: str, **changes: object) -> Path:
        folder = tmp_path / name
        folder.mkdir()
        (folder / "config.json").write_text(json.dumps(config | changes))
        return folder

    torch.save({"x": Trap()}, model("pickle") / "pytorch_model.bin")
    code = model("code", model_type="own", auto_map={"AutoConfig": "own.Own"})
    (code / "own.py").write_text(f"import os\nos.mkdir({str(sprung)!r})\nclass Own: pass\n")
    os.mkfifo(model("pipe") / "model.safetensors")
    for name, said in (("pickle", "safetensors"), ("code", "cannot load"), ("pipe", "regular")):
        with pytest.raises(GcbenchError, match=said):
            find_depth(f"hf:{tmp_path}/{name}")
    assert not sprung.exists()
