"""XML parsing without document types and entities, with bounded depth, size and names.

expat is used without name spaces, because real URDFs use prefixes that are not declared.
"""

from __future__ import annotations

from xml.etree import ElementTree
from xml.parsers import expat

from ...errors import ModelError

MAX_DEPTH = 64
MAX_ELEMENTS = 500_000
MAX_ATTRIBUTE = 4096

Element = ElementTree.Element


class _RootReached(Exception):  # noqa: N818 - a signal
    pass


def refuse_doctype(data: bytes) -> None:
    """Raise ModelError if a document declares a type (and so could declare entities).

    Reads the prologue only, in the encoding that the document declares: a search for bytes would
    miss UTF-16.
    """
    parser = _parser()

    def start(tag: str, attributes: dict[str, str]) -> None:
        raise _RootReached

    parser.StartElementHandler = start
    try:
        parser.Parse(data, True)
    except _RootReached:
        return
    except expat.ExpatError as error:
        raise ModelError(f"is not well-formed XML ({error})") from error


def parse_xml(data: bytes) -> Element:
    """Return the root element; tags keep their prefixes. Raise ModelError if it is not valid."""
    parser, builder = _parser(), ElementTree.TreeBuilder()
    depth = count = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        depth, count = depth + 1, count + 1
        if depth > MAX_DEPTH or count > MAX_ELEMENTS:
            raise ModelError(f"has more than {MAX_DEPTH} levels or {MAX_ELEMENTS} elements")
        for name, value in attributes.items():
            if len(value) > MAX_ATTRIBUTE or len(name) > MAX_ATTRIBUTE:
                raise ModelError(f"line {parser.CurrentLineNumber}: an attribute of <{tag[:40]}> "
                                 f"is longer than {MAX_ATTRIBUTE} characters")
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    parser.StartElementHandler, parser.EndElementHandler = start, end
    try:
        parser.Parse(data.lstrip(), True)  # blank lines before <?xml are common and harmless
        return builder.close()
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise ModelError(f"is not well-formed XML ({error})") from error


def xml_bytes(element: Element) -> bytes:
    """Return the document of an element, UTF-8."""
    return ElementTree.tostring(element, encoding="utf-8")


def new_element(tag: str, attributes: dict[str, str]) -> Element:
    """Return an element without children."""
    return ElementTree.Element(tag, attributes)


def _parser() -> expat.XMLParserType:
    parser = expat.ParserCreate()

    def doctype(name: str, system: str | None, public: str | None, internal: bool) -> None:
        raise ModelError("declares a document type (<!DOCTYPE>), which is not read; delete it")

    parser.StartDoctypeDeclHandler = doctype
    return parser
