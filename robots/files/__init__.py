"""Files: asset paths that stay inside a model, hardened XML, atomic writes, locks, downloads."""

from __future__ import annotations

from .atomic import remove_leftovers, temporary_name, write_atomically
from .download import WheelFiles, cache_folder, whole_folder
from .lock import LOCK, locked
from .paths import (
    BUFFERS,
    MATERIALS,
    MAX_FILE_BYTES,
    TEXTURES,
    Asset,
    AssetFinder,
    MissingAssetError,
    asset_finder,
    read_file,
)
from .xml import Element, new_element, parse_xml, refuse_doctype, xml_bytes

__all__ = [
    "BUFFERS",
    "LOCK",
    "MATERIALS",
    "MAX_FILE_BYTES",
    "TEXTURES",
    "Asset",
    "AssetFinder",
    "Element",
    "MissingAssetError",
    "WheelFiles",
    "asset_finder",
    "cache_folder",
    "locked",
    "new_element",
    "parse_xml",
    "read_file",
    "refuse_doctype",
    "remove_leftovers",
    "temporary_name",
    "whole_folder",
    "write_atomically",
    "xml_bytes",
]
