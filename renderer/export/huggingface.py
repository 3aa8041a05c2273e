"""A dataset for the Hugging Face hub: shards of WebDataset, a dataset card, Croissant metadata.

    data/SPLIT-NNNNNN.tar    samples as in webdataset.py; SPLIT is the dataset's stream
    README.md                the card, with the types of all columns
    croissant.json           ML Commons Croissant 1.0

`datasets.load_dataset(FOLDER)` reads it, from the disk or as a stream.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ..dataset import Dataset
from ..runtime import Archive, dump_json
from ..types import Sequence
from .webdataset import WebDataset, fields_of
from .writer import SequenceRecord

_TEXTS = ("name", "source", "licence", "sha256", "instance")
"""What the samples tell of a model; all samples have these."""
_URL = "https://github.com/gcbench/gcbench"
_CONTEXT = {
    "@language": "en", "@vocab": "https://schema.org/", "sc": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/", "rai": "http://mlcommons.org/croissant/RAI/",
    "dct": "http://purl.org/dc/terms/", "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    **{name: f"cr:{name}" for name in (
        "citeAs", "column", "equivalentProperty", "extract", "field", "fileObject", "fileProperty",
        "fileSet", "format", "includes", "isLiveDataset", "jsonPath", "key", "md5", "parentField",
        "path", "recordSet", "references", "regex", "repeated", "replace", "samplingRate",
        "separator", "source", "subField", "transform")},
}
"""The context that Croissant 1.0 prescribes."""


class HuggingFace(WebDataset):
    """See `Writer`."""

    def __init__(self, folder: Path, dataset: Dataset) -> None:
        super().__init__(folder, dataset)
        (folder / "data").mkdir(exist_ok=True)
        self._columns: list[dict[str, Any]] = []
        self._licences: dict[str, None] = {}
        self._sequences = 0

    def add(self, sequence: Sequence, archive: Archive) -> dict[str, Any]:
        record = super().add(sequence, archive)
        licence = str(sequence.meta.asset.get("licence", "")) or "unknown"
        columns = _columns(sequence, self.facts(sequence, 0))
        return {**record, "columns": columns, "licence": licence}

    def keep(self, record: SequenceRecord) -> None:
        super().keep(record)
        self._columns = record["columns"]
        self._licences[record["licence"]] = None
        self._sequences += 1

    def finish(self) -> None:
        super().finish()
        shards = sorted((self.folder / "data").glob("*.tar"))
        (self.folder / "README.md").write_text(self._card(), encoding="utf-8")
        (self.folder / "croissant.json").write_bytes(dump_json(self._croissant(shards)))

    def shard_path(self, number: int) -> Path:
        return self.folder / "data" / f"{self._split}-{number:06d}.tar"

    def facts(self, sequence: Sequence, t: int) -> dict[str, object]:
        asset = {key: str(sequence.meta.asset.get(key, "")) for key in _TEXTS}
        return {**super().facts(sequence, t), "asset": asset}

    @property
    def _split(self) -> str:
        return self.dataset.config.stream

    @property
    def _name(self) -> str:
        return self.dataset.path.absolute().name

    @property
    def _summary(self) -> str:
        return (f"{self._frames} frames of {self._sequences} synthetic videos of articulated "
                f"objects ({Path(self.dataset.config.robot).stem}) with exact ground truth: depth, "
                "parts, optical flow, visibility, poses, joint positions, cameras.")

    def _card(self) -> str:
        head = {
            "pretty_name": self._name, "license": "other", "license_name": "of-the-models",
            "tags": ["robotics", "optical-flow", "articulated-objects", "synthetic", "gcbench"],
            "task_categories": ["robotics", "depth-estimation", "image-segmentation"],
            "configs": [{"config_name": "default", "data_files": [
                {"split": self._split, "path": f"data/{self._split}-*.tar"}]}],
            "dataset_info": {"features": self._columns},
        }
        licences = "\n".join(f"* {licence}" for licence in self._licences)
        # JSON is YAML: a quoted name cannot end the head of the card.
        return f"""---
{json.dumps(head, indent=1)}
---

# {self._name}

{self._summary}

```python
from datasets import load_dataset

data = load_dataset("PATH", split="{self._split}", streaming=True).with_format("numpy")
sample = next(iter(data))
sample["flow.npy.gz"]   # [H W 2] px to the next frame, NaN where unknown
sample["json"]["joint_positions"]
```

The format "numpy" rounds the numbers of `json` to float32; without a format they are exact.

Lengths are in m, angles in rad, flow in px. `depth.npy.gz` is z in the camera frame, 0 where there
is no surface. `part.npy.gz` has 0 for the background and numbers from 1 in the order of
`json.part_names`. `visibility.npy.gz` is 0 (background), 1 (visible in the next frame), 2 (hidden
there), 3 (out of the image) or 255 (there is no next frame).

Made by gcbench. Licences of the models:

{licences}
"""

    def _croissant(self, shards: list[Path]) -> dict[str, Any]:
        files: list[dict[str, Any]] = []
        for shard in shards:
            name = shard.relative_to(self.folder).as_posix()
            digest = hashlib.sha256()
            with shard.open("rb") as file:
                while block := file.read(2**20):
                    digest.update(block)
            files.append({"@type": "cr:FileObject", "@id": name, "name": name, "contentUrl": name,
                          "encodingFormat": "application/x-tar", "sha256": digest.hexdigest()})
        return {
            "@context": _CONTEXT, "@type": "sc:Dataset", "name": self._name,
            "description": self._summary, "conformsTo": "http://mlcommons.org/croissant/1.0",
            "license": list(self._licences), "url": _URL,
            "citeAs": f"@software{{gcbench, title = {{gcbench}}, url = {{{_URL}}}}}",
            "version": "1.0.0", "distribution": files,
        }


def _columns(sequence: Sequence, facts: Mapping[str, object]) -> list[dict[str, Any]]:
    """Return the types of a sample's columns, in the form of a dataset card."""
    arrays = sequence.state.at(0)
    struct: list[dict[str, Any]] = [{"name": "sequence", "dtype": "string"}]
    for name, value in facts.items():
        if name in arrays:
            struct.append({"name": name, **_list_type(arrays[name])})
        elif isinstance(value, Mapping):
            texts = [{"name": key, "dtype": "string"} for key in value]
            struct.append({"name": name, "struct": texts})
        else:
            struct.append({"name": name, **({"dtype": "int64"} if isinstance(value, int)
                                            else {"list": "string"})})
    fields = [
        {"name": f"{kind}.npy.gz", "dtype": {
            f"array{field.ndim}_d": {"shape": list(field.shape), "dtype": field.dtype.name}}}
        for kind, field in fields_of(sequence, 0).items()
    ]
    return [{"name": "__key__", "dtype": "string"}, {"name": "__url__", "dtype": "string"},
            {"name": "json", "struct": struct}, {"name": "rgb.png", "dtype": "image"}, *fields]


def _list_type(array: NDArray[Any]) -> dict[str, Any]:
    dtype = array.dtype.name
    if array.ndim == 0:
        return {"dtype": dtype}
    inner: Any = dtype
    for _ in range(array.ndim - 1):
        inner = {"list": inner}
    return {"list": inner}
