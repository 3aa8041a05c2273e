"""Files: bounded reads, atomic writes, locks, asset paths in a model, XML, progress, downloads."""

from __future__ import annotations

from .atomic import (
    create_atomically,
    create_folder_atomically,
    remove_leftovers,
    scratch_folder,
    temporary_name,
    write_atomically,
)
from .bounded import hash_files, read_bounded
from .download import WheelFiles, cache_folder
from .lock import LOCK, FolderInUseError, lock_briefly, lock_folder
from .paths import (
    MATERIALS,
    TEXTURES,
    Asset,
    AssetFinder,
    MissingAssetError,
    OutsideAssetError,
    asset_finder,
)
from .progress import show_progress
from .xml import Element, new_element, parse_xml, refuse_doctype, xml_bytes

__all__ = [
    "LOCK", "MATERIALS", "TEXTURES", "Asset", "AssetFinder", "Element", "FolderInUseError",
    "MissingAssetError", "OutsideAssetError", "WheelFiles", "asset_finder", "cache_folder",
    "create_atomically", "create_folder_atomically", "hash_files", "lock_briefly", "lock_folder",
    "new_element", "parse_xml", "read_bounded", "refuse_doctype", "remove_leftovers",
    "scratch_folder", "show_progress", "temporary_name", "write_atomically", "xml_bytes",
]
